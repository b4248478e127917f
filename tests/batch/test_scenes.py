"""Which scenes a batch has."""

from collections.abc import Callable
from pathlib import Path

import pytest

from sculpt_framework.batch.scenes import batch_matrix, check_options, find_scenes
from sculpt_framework.errors import ConfigError

MakeScenes = Callable[..., Path]


def test_a_folder_stands_for_the_folders_in_it(make_scenes: MakeScenes):
    folder = make_scenes("mug", "apple", ".hidden")
    (folder / "notes.txt").touch()
    scenes = find_scenes(str(folder))
    assert [(scene.label, scene.data) for scene in scenes] == [
        ("apple", str(folder / "apple")),
        ("mug", str(folder / "mug")),
    ]


def test_a_list_has_a_scene_per_line_relative_to_itself(make_scenes: MakeScenes, monkeypatch: pytest.MonkeyPatch):
    folder = make_scenes("mug", "apple", "more/mug")
    text = "# fruit\n\napple\n  mug  \nmore/mug\ndemo:blob\n"
    (folder / "list.txt").write_text(text, encoding="utf-8")
    monkeypatch.chdir("/")
    scenes = find_scenes(str(folder / "list.txt"))
    assert [scene.label for scene in scenes] == ["apple", "mug", "mug-2", "blob"]
    assert scenes[2].data == str(folder / "more" / "mug")
    assert scenes[3].data == "demo:blob"


def test_mistakes(make_scenes: MakeScenes, tmp_path: Path):
    folder = make_scenes("mug", "one/train")
    (folder / "one" / "transforms_train.json").touch()
    (folder / "empty.txt").write_text("# none\n", encoding="utf-8")
    (folder / "twice.txt").write_text("mug\nmug\n", encoding="utf-8")
    (folder / "gone.txt").write_text("mug\npear\n", encoding="utf-8")
    (folder / "picture.txt").write_bytes(b"\xff\xfe\x00")
    for given, message in (
        (tmp_path / "nowhere", "no such folder or file"),
        (folder / "mug", "has no folders in it"),
        (folder / "one", "is one scene; give the folder it is in"),
        (folder / "empty.txt", "names no scenes"),
        (folder / "twice.txt", "is given twice"),
        (folder / "gone.txt", "pear: no such folder"),
        (folder / "picture.txt", "cannot be read as a list"),
    ):
        with pytest.raises(ConfigError, match=message):
            find_scenes(str(given))


def test_every_run_has_the_same_options(make_scenes: MakeScenes):
    folder = make_scenes("mug", "apple")
    matrix = batch_matrix(find_scenes(str(folder)), "gaussian-sculpting-tiny", ("--seed", "3", "--max-time", "9"))
    assert matrix.title == "gaussian-sculpting-tiny on 2 scenes"
    assert [cell.name for cell in matrix.cells] == ["apple", "mug"]
    assert matrix.cells[1].words == (
        *("gaussian-sculpting-tiny", "--data", str(folder / "mug")),
        *("--seed", "3", "--max-time", "9"),
    )
    assert {(cell.seed, cell.timed) for cell in matrix.cells} == {(3, False)}
    with pytest.raises(ConfigError, match="no method"):
        batch_matrix(find_scenes(str(folder)), "nothing", ())


@pytest.mark.parametrize("word", ["--data", "--output=x", "--resume", "--viewer", "--refine_box"])
def test_what_differs_from_run_to_run_is_not_for_all(word: str):
    with pytest.raises(ConfigError, match="cannot be given to all runs of a batch"):
        check_options(("--seed", "1", word))
