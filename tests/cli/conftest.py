import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

HERE = Path(__file__).parent

FAKE_ENTRY_POINTS = {
    "sculpt_framework.methods": {"fake": "sculpt_fake:fake"},
    "sculpt_framework.fields": {"plain": "sculpt_fake:PlainConfig", "fancy": "sculpt_fake:FancyConfig"},
    "sculpt_framework.extractors": {"cubes": "sculpt_fake:CubesConfig"},
    "sculpt_framework.binders": {"glue": "sculpt_fake:GlueConfig"},
    "sculpt_framework.appearances": {"paint": "sculpt_fake:PaintConfig"},
    "sculpt_framework.rasterizers": {"dots": "sculpt_fake:DotsConfig"},
    "sculpt_framework.initializers": {"ball": "sculpt_fake:BallConfig"},
    "sculpt_framework.datasets": {"folder": "sculpt_fake:FolderConfig"},
    "sculpt_framework.losses": {"likeness": "sculpt_fake:LikenessConfig", "outline": "sculpt_fake:OutlineConfig"},
    "sculpt_framework.constraints": {"tight": "sculpt_fake:TightConfig", "even": "sculpt_fake:EvenConfig"},
    "sculpt_framework.observers": {"diary": "sculpt_fake:DiaryConfig"},
}


def write_metadata(target: Path, package: str, entry_points: Mapping[str, Mapping[str, str]]) -> None:
    """The metadata an installer leaves for ``package`` in the import folder ``target``."""
    folder = target / f"{package.replace('-', '_')}-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n", encoding="utf-8")
    groups = (
        f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in names.items()) for group, names in entry_points.items()
    )
    (folder / "entry_points.txt").write_text("\n".join(groups), encoding="utf-8")


Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """``install(package, entry_points, module=source)``: a package on the import path, for one test."""
    before = set(sys.modules)

    def put(package: str, entry_points: Mapping[str, Mapping[str, str]], **modules: str) -> Path:
        target = tmp_path / "installed" / package
        write_metadata(target, package, entry_points)
        for name, source in modules.items():
            (target / f"{name}.py").write_text(source, encoding="utf-8")
        monkeypatch.syspath_prepend(target)
        return target

    yield put
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(sys.modules[name].__file__):
            del sys.modules[name]
    importlib.invalidate_caches()


@pytest.fixture
def fake(install: Install) -> Path:
    """The package sculpt-fake is installed: the method ``fake``, and components in every slot. Returns its folder."""
    source = (HERE / "sculpt_fake.py").read_text(encoding="utf-8")
    return install("sculpt-fake", FAKE_ENTRY_POINTS, sculpt_fake=source)
