"""``sculpt-data inspect`` and ``masks``: what is said, and the pictures."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from layouts import make_shots, write_colmap, write_nerfstudio

from sculpt_framework.cli.data import data
from sculpt_framework.errors import DataError, OutputError
from sculpt_framework.posed_images.contact_sheet import contact_sheet
from sculpt_framework.posed_images.findings import findings, widest_gap
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig


def _run(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", ["sculpt-data", *(str(word) for word in words)])
    data()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_nerfstudio(tmp_path_factory.mktemp("inspect") / "s", make_shots(16, 64))


@pytest.fixture
def scene(folder: Path) -> Scene:
    return AutoDatasetConfig().build(str(folder)).load()


def test_a_good_scene_has_no_findings(scene: Scene):
    assert findings(scene) == []


def test_what_is_wrong_is_found(scene: Scene):
    views = list(scene.train)
    noisy = [
        view.rgb + 0.1 * torch.from_numpy(np.random.default_rng(0).normal(size=view.rgb.shape)).float()
        for view in views
    ]
    views = [replace(view, rgb=rgb) for view, rgb in zip(views, noisy, strict=True)]
    views[1] = replace(views[1], rgb=torch.from_numpy(cv2.GaussianBlur(views[1].rgb.numpy(), (0, 0), 4)))
    views[2] = replace(views[2], rgb=0.3 * views[2].rgb)
    said = findings(replace(scene, train=tuple(views)))
    assert any("1 images are much less sharp than the rest (images/r_01)" in line for line in said)
    assert any("1 images are much darker than the rest (images/r_02)" in line for line in said)
    alpha = scene.train[3].alpha
    assert alpha is not None
    shifted = [*scene.train[:3], replace(scene.train[3], alpha=torch.roll(alpha, 25, dims=1)), *scene.train[4:]]
    said = findings(replace(scene, train=tuple(shifted)))
    assert any("1 masks reach out of the box: a wrong mask or camera (images/r_03)" in line for line in said)


def test_small_and_cut_off_objects_are_found(scene: Scene):
    small, cut = [], []
    for view in scene.train:
        assert view.alpha is not None
        dot = torch.zeros_like(view.alpha)
        dot[30:34, 30:34] = 1
        small.append(replace(view, alpha=dot))
        cut.append(replace(view, alpha=torch.ones_like(view.alpha)))
    assert any(
        "the object fills 6 % of an image's side" in line for line in findings(replace(scene, train=tuple(small)))
    )
    said = findings(replace(scene, train=tuple(cut)))
    assert any("16 of 16 images cut the object off at their border" in line for line in said)
    bare = [replace(view, alpha=None) for view in scene.train]
    assert findings(replace(scene, train=tuple(bare)))[0].startswith("no masks: the background is learned")


def test_a_gap_between_views_is_found(scene: Scene):
    above = tuple(view for view in scene.train if float(view.camera.position[2]) > 1)
    gap, direction = widest_gap(above, scene.box)
    assert gap > 90
    assert direction[2] < -0.5
    assert any("nothing was photographed from within" in line for line in findings(replace(scene, train=above)))


def test_the_sheet_shows_views_masks_and_box(scene: Scene):
    sheet = contact_sheet(scene)
    assert sheet.shape == (600 + 2 * 150, 1200, 3)
    green = (np.abs(sheet[:600].astype(int) - (46, 125, 50)).max(axis=2) < 30).sum()
    pink = (np.abs(sheet[600:].astype(int) - (230, 30, 120)).max(axis=2) < 30).sum()
    assert green > 200
    assert pink > 16 * 80


def test_inspect_writes_a_picture(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    _run(monkeypatch, "inspect", folder, "--picture", tmp_path / "a.png", "--downscale", 2)
    out = capsys.readouterr().out
    assert "train      16 views, 32x32, with alpha" in out
    assert f"picture    {tmp_path / 'a.png'}" in out
    assert cv2.imread(str(tmp_path / "a.png")) is not None


def test_masks_that_are_written_are_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Keyed masks, written into the folder where masks are looked for, are what the next run uses."""
    folder = write_colmap(tmp_path / "s", make_shots(4), masks=False)
    before = AutoDatasetConfig().build(str(folder)).load()
    _run(monkeypatch, "masks", folder, "--out", folder / "masks")
    assert "masks: 4 masks" in capsys.readouterr().out
    assert (folder / "masks-sheet.png").is_file()
    after = AutoDatasetConfig().build(str(folder)).load()
    assert any("4 of 4 images have a mask in a file of its own" in note for note in after.notes)
    for old, new in zip(before.train, after.train, strict=True):
        assert old.alpha is not None
        assert new.alpha is not None
        assert (old.alpha - new.alpha).abs().max() <= 0.5 / 255 + 1e-6


def test_masks_of_frames_in_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = write_nerfstudio(tmp_path / "s", make_shots(4))
    _run(monkeypatch, "masks", folder, "--out", tmp_path / "found")
    assert sorted(path.name for path in (tmp_path / "found").iterdir()) == [f"r_{index:02d}.png" for index in range(4)]


def test_masks_are_not_written_over(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(OutputError, match=r"masks: exists and is not empty"):
        _run(monkeypatch, "masks", folder, "--out", folder / "masks")
    document = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "transforms.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(DataError, match=r"16 of 16 images are not there"):
        _run(monkeypatch, "masks", tmp_path / "s", "--out", tmp_path / "m")
    assert not (tmp_path / "m").exists()
