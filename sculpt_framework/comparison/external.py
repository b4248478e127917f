"""Meshes other programs made, measured as ours are, so that they can stand beside runs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from sculpt_framework.comparison.runs import RunRecord
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.evaluation.mesh_report import result_measures


@dataclass(frozen=True, kw_only=True)
class ExternalMesh:
    """What ``--mesh NAME[@SCENE]=FILE[:SECONDS]`` says."""

    name: str
    scene: str | None
    path: Path
    seconds: float | None
    """How long it took to make, as its makers say; None: not known."""


def parse_mesh(word: str) -> ExternalMesh:
    """Raises ConfigError where the word has another form."""
    label, equals, rest = word.partition("=")
    name, at, scene = label.partition("@")
    if not (name and equals and rest) or (at and not scene):
        raise ConfigError(f"--mesh {word}: expected NAME=FILE, NAME=FILE:SECONDS or NAME@SCENE=FILE:SECONDS.")
    path, colon, tail = rest.rpartition(":")
    seconds = _seconds(tail) if colon and path else None
    return ExternalMesh(
        name=name, scene=scene or None, path=Path(path if seconds is not None else rest), seconds=seconds
    )


def parse_references(words: Sequence[str]) -> Mapping[str | None, Path]:
    """``--reference FILE`` (under None) and ``--reference SCENE=FILE``. Raises ConfigError for one given twice."""
    out: dict[str | None, Path] = {}
    for word in words:
        scene, equals, path = word.partition("=")
        key, file = (scene, Path(path)) if equals and not Path(word).exists() else (None, Path(word))
        if key in out:
            raise ConfigError(
                f"--reference {word}: there is one already{f' for {key}' if key else ''}; give each once."
            )
        out[key] = file
    return out


def measure_meshes(
    meshes: Sequence[ExternalMesh],
    runs: Sequence[RunRecord],
    references: Mapping[str | None, Path],
    *,
    samples: int = 200_000,
) -> tuple[RunRecord, ...]:
    """A record per mesh, measured against its scene's reference with ``samples`` points each way.

    A mesh that names no scene belongs to the runs' scene, if that is one; without runs, to the reference's file name.
    The reference is the one given for the scene, the one given for all, or the one the scene's runs were measured
    against. A mesh without area is a failure. Raises ConfigError where scene or reference are not known, DataError
    where a file cannot be read.
    """
    prepared: dict[Path, MeasuredMesh] = {}
    out = []
    for each in meshes:
        scene = each.scene or _only_scene(each, runs, references)
        path = _reference_of(scene, runs, references)
        if path not in prepared:
            try:
                prepared[path] = MeasuredMesh(load_mesh(path), samples)
            except ValueError as error:
                raise DataError(f"{path} cannot be compared with: all its faces have area 0.") from error
        out.append(_measured(each, scene, path, prepared[path], samples))
    return tuple(out)


def _measured(each: ExternalMesh, scene: str, path: Path, reference: MeasuredMesh, samples: int) -> RunRecord:
    mesh = load_mesh(each.path)
    flat = not mesh.areas.sum() > 0
    final = result_measures(mesh, reference, samples)
    # Nobody told which clock the seconds are of: they are taken for whichever is asked for.
    final |= {"faces": len(mesh.faces), **dict.fromkeys(("t_train_s", "t_wall_s", "t_cpu_s"), each.seconds)}
    return RunRecord(
        name=each.name,
        scene=scene,
        method=each.name,
        final=final,
        certificate=asdict(certify(mesh.vertices, mesh.faces)),
        failed=flat,
        reason="all its faces have area 0" if flat else None,
        reference=path,
    )


def _only_scene(each: ExternalMesh, runs: Sequence[RunRecord], references: Mapping[str | None, Path]) -> str:
    scenes = sorted({run.scene for run in runs} | {scene for scene in references if scene})
    if len(scenes) == 1:
        return scenes[0]
    if not scenes and None in references:
        return references[None].stem
    told = f"there are {', '.join(scenes)}" if scenes else "there is neither a run nor a --reference"
    raise ConfigError(f"--mesh {each.name}={each.path}: of which scene? {told}; give {each.name}@SCENE=FILE.")


def _reference_of(scene: str, runs: Sequence[RunRecord], references: Mapping[str | None, Path]) -> Path:
    given = references.get(scene) or references.get(None)
    if given is not None:
        return given
    found = [run.reference for run in runs if run.scene == scene and run.reference is not None]
    if not found:
        raise ConfigError(f"no reference mesh is known for {scene}; give --reference FILE or --reference {scene}=FILE.")
    return found[0]


def _seconds(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if value > 0 else None
