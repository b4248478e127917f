"""Whatever the bytes on disk are, loading gives a scene or a DataError of one line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from plain_scenes import edit_transforms, load, make_scene

from sculpt_framework.errors import DataError
from sculpt_framework.types import Scene

QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
MUTATIONS = st.lists(
    st.tuples(st.sampled_from(["flip", "cut", "insert", "drop"]), st.floats(0, 1), st.integers(0, 255)),
    min_size=1,
    max_size=4,
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=12,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_scene(tmp_path_factory.mktemp("fuzz") / "scene", views=2)


def _mutate(data: bytes, mutations: list[tuple[str, float, int]]) -> bytes:
    for kind, where, value in mutations:
        at = int(where * len(data))
        if kind == "flip" and at < len(data):
            data = data[:at] + bytes([data[at] ^ value]) + data[at + 1 :]
        elif kind == "cut":
            data = data[:at]
        elif kind == "insert":
            data = data[:at] + bytes([value]) * 3 + data[at:]
        else:
            data = data[:at] + data[at + 1 :]
    return data


def _loads_or_says_why(folder: Path) -> None:
    try:
        scene = load(folder)
    except DataError as error:
        message = str(error)
    else:
        _is_sound(scene)
        return
    assert "\n" not in message


def _is_sound(scene: Scene) -> None:
    assert scene.train
    assert all(np.isfinite(view.camera.world_to_camera.numpy()).all() for view in scene.train)
    assert scene.box.minimum.isfinite().all()
    assert (scene.box.maximum > scene.box.minimum).all()


@pytest.mark.parametrize("name", ["transforms_train.json", "train/r_0.png"])
@given(mutations=MUTATIONS)
@QUICK
def test_mutated_bytes(folder: Path, name: str, mutations: list[tuple[str, float, int]]) -> None:
    path = folder / name
    original = path.read_bytes()
    try:
        path.write_bytes(_mutate(original, mutations))
        _loads_or_says_why(folder)
    finally:
        path.write_bytes(original)


@given(key=st.sampled_from(["camera_angle_x", "fl_x", "w", "cx", "k1", "frames"]), value=JSON)
@example(key="cx", value=3.4e38)
@example(key="cx", value=1.9e19)
@QUICK
def test_any_value_for_a_key_of_the_file(folder: Path, key: str, value: object) -> None:
    _with(folder, lambda document: document.update({key: value}))


@given(key=st.sampled_from(["file_path", "transform_matrix", "fl_y", "camera_angle_y"]), value=JSON)
@QUICK
def test_any_value_for_a_key_of_a_frame(folder: Path, key: str, value: object) -> None:
    _with(folder, lambda document: document["frames"][1].update({key: value}))


@given(st.lists(st.floats(), min_size=16, max_size=16))
@QUICK
def test_any_matrix(folder: Path, numbers: list[float]) -> None:
    rows = [numbers[i : i + 4] for i in range(0, 16, 4)]
    _with(folder, lambda document: document["frames"][0].update(transform_matrix=rows))


@given(st.floats(-1e6, 1e6), st.floats(0.001, 3.14), st.floats(1e-3, 1e6))
@QUICK
def test_any_lens_and_place(folder: Path, shift: float, angle: float, scale: float) -> None:
    def change(document: dict) -> None:
        document["camera_angle_x"] = angle
        for frame in document["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] = scale * row[3] + shift

    _with(folder, change)


def _with(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "transforms_train.json"
    original = path.read_text(encoding="utf-8")
    try:
        edit_transforms(folder, change)
        _loads_or_says_why(folder)
    finally:
        path.write_text(original, encoding="utf-8")
