"""Formats of other packages in ``sculpt-export``, and what its help says and imports."""

import subprocess
import sys
from pathlib import Path

import pytest

from sculpt_framework import registry
from sculpt_framework.cli.export import export, overview
from sculpt_framework.errors import ComponentImportError, ConfigError

OFF = """
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sculpt_framework.export.options import MeshExporterConfig
from sculpt_framework.exporters import Exporter


@dataclass(frozen=True, kw_only=True)
class OffConfig(MeshExporterConfig):
    '''The mesh as OFF.'''

    digits: int = 6
    '''Decimal places.'''

    @property
    def file_name(self):
        return f"{self.stem()}.off"

    def build(self):
        self.check()
        return OffExporter(self)


class OffExporter(Exporter):
    def __init__(self, config):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        from sculpt_framework.export.atomic import write_atomically
        from sculpt_framework.export.placing import FileFrame, place

        mesh = place(run_dir, self._config, FileFrame(up="z"))
        lines = ["OFF", f"{len(mesh.vertices)} {len(mesh.faces)} 0"]
        lines += [" ".join(f"{x:.{self._config.digits}f}" for x in row) for row in mesh.vertices]
        lines += ["3 " + " ".join(map(str, row)) for row in mesh.faces]
        write_atomically(out, "\\n".join(lines).encode())
        return [str(out), *mesh.facts()]
"""
GROUP = "sculpt_framework.exporters"


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    import numpy as np
    import trimesh

    from sculpt_framework.export.mesh_files import write_mesh_ply

    folder = tmp_path / "run"
    folder.mkdir()
    shape = trimesh.creation.icosphere(subdivisions=1)
    write_mesh_ply(folder / "mesh.ply", np.array(shape.vertices), np.array(shape.faces, np.int64))
    return folder


def test_a_package_adds_a_format(install, run_dir: Path, capsys: pytest.CaptureFixture[str]):
    install("sculpt-off", {GROUP: {"off": "sculpt_off:OffConfig"}}, sculpt_off=OFF)
    assert registry.export_formats()[-1] == "off"
    assert "  off        The mesh as OFF.\n" in overview()
    export([str(run_dir), "--format", "off", "--size", "80mm", "--up", "-Y", "--digits", "3"])
    import trimesh

    mesh = trimesh.load_mesh(run_dir / "mesh.off")
    assert mesh.is_watertight
    assert mesh.extents.max() == pytest.approx(80, abs=2e-3)
    assert "80 mm, watertight" in capsys.readouterr().out
    with pytest.raises(ConfigError, match=r"--digits goes with --format off, not obj"):
        export([str(run_dir), "--format", "obj", "--digits", "3"])


def test_a_broken_format_disturbs_no_other(install, run_dir: Path):
    install("sculpt-broken", {GROUP: {"broken": "sculpt_broken:Config"}}, sculpt_broken="1 / 0")
    install("sculpt-odd", {GROUP: {"odd": "sculpt_odd:Config"}}, sculpt_odd="Config = 3")
    assert "  broken     (not available: division by zero)\n" in overview()
    export([str(run_dir), "--format", "obj"])
    with pytest.raises(ComponentImportError, match=r"export format 'broken' of package 'sculpt-broken'"):
        export([str(run_dir), "--format", "broken"])
    with pytest.raises(ComponentImportError, match=r"is not a dataclass derived from ExporterConfig"):
        export([str(run_dir), "--format", "odd"])
    # An option that no format has, while one of them is broken.
    with pytest.raises(ConfigError, match=r"--format obj has no option --digits\."):
        export([str(run_dir), "--format", "obj", "--digits", "3"])


def test_the_overview_says_a_line_of_every_built_in_format():
    listed = overview().partition("formats:\n")[2].partition("\n\n")[0]
    lines = dict(line.strip().split(maxsplit=1) for line in listed.splitlines())
    assert list(lines) == list(registry.export_formats())
    assert not [line for line in lines.values() if "not available" in line]


@pytest.mark.parametrize("words", ["--help", "--format 3mf --help"])
def test_help_imports_nothing_heavy(words: str):
    script = (
        f"import sys\nsys.argv = ['sculpt-export', *{words.split()!r}]\n"
        "from sculpt_framework.cli.export import main\n"
        "try:\n    main()\n"
        "finally:\n"
        "    sys.stderr.write(','.join({'torch', 'trimesh', 'numpy', 'lib3mf'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False, encoding="utf-8"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "usage: sculpt-export" in done.stdout
