"""From photographs or a video to a scene in COLMAP's layout, step by step; what is done is not done again."""

import json
import os
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sculpt_framework.errors import DataError, OutputError
from sculpt_framework.export.atomic import cannot_write, link_or_copy, write_atomically
from sculpt_framework.posed_images.heic import CONVERSIONS, converted
from sculpt_framework.posed_images.masks import read_mask
from sculpt_framework.posing import colmap
from sculpt_framework.posing.announcer import Announcer
from sculpt_framework.posing.explained import explained
from sculpt_framework.posing.joining import join
from sculpt_framework.posing.lenses import Sorted, sort_by_lens
from sculpt_framework.posing.likely_pairs import PARTNERS, likely_pairs
from sculpt_framework.posing.options import PosingOptions
from sculpt_framework.posing.outcome import NAME, Outcome, listed, nothing_placed, read_outcome, reasons
from sculpt_framework.posing.pairs import EXHAUSTIVE_UP_TO, choose_pairs
from sculpt_framework.posing.picture import draw_posing
from sculpt_framework.posing.second_opinion import best_explained
from sculpt_framework.posing.source import CONVERTED, FEWEST, Photographs, find_photographs, fingerprint, is_video
from sculpt_framework.posing.upright import upright_frame
from sculpt_framework.posing.video import choose_frames, look_through, write_frames
from sculpt_framework.threads import in_threads

if TYPE_CHECKING:
    import pycolmap

WORK = ".posing"
"""Folder of the database and of what is known between calls, inside the scene."""
PICTURE = "posing.png"
_STRAIGHT = (
    "the distortion of the lens cannot be told from these photographs; it is taken to be straight, and the cameras may "
    "be wrong. Photographs nearer to the object tell more, or whole ones (--ignore-masks) where the surroundings do "
    "not move against it."
)
_CONTRADICTED = 0.25
"""Share of its matches below which a photograph is named: right cameras explain more, even where parts repeat."""
_WRONG = (
    "the cameras of {} explain less than a quarter of their matches and may be wrong: parts that repeat, such as "
    "studs, tiles or windows, look like each other. Photographs in between tell them apart."
)
_STANDING = (
    "{} of {} features are left out: they stand still while the object turns in front of the camera (background, "
    "highlights)."
)


@dataclass(frozen=True, kw_only=True)
class _State:
    """What a later call goes on from."""

    key: str
    """Of the input and of the options that change the result."""
    source: str
    """The folder of photographs, or the video, that the scene is of."""
    inside: bool
    """Whether the photographs are those in the scene's own ``images/``, which are the user's."""
    frames: tuple[str, ...] = ()
    """Of a video, once all of them are written."""
    standing: tuple[int, int] | None = None
    """Features on a background that stands still, of how many, once they are left out."""
    seconds: float = 0.0
    """Of the steps that are finished."""


@dataclass(kw_only=True)
class _Posing:
    data: Path
    scene: Path
    options: PosingOptions
    announce: Announcer
    state: _State
    began: float = field(default_factory=time.monotonic)

    @property
    def work(self) -> Path:
        return self.scene / WORK

    @property
    def seconds(self) -> float:
        return self.state.seconds + time.monotonic() - self.began

    def tell(self, step: str) -> Callable[[int, int], None]:
        return lambda done, total: self.announce.step(step, done, total)

    def keep(self, state: _State) -> None:
        self.state = replace(state, seconds=self.seconds)
        self.began = time.monotonic()
        write_atomically(self.work / "state.json", json.dumps(asdict(self.state)).encode())


def pose(data: Path, scene: Path, options: PosingOptions, announce: Announcer) -> Outcome:
    """Find the cameras of a folder of photographs, or of frames of a video, and write them into the folder ``scene``.

    ``scene`` then has ``images/``, ``masks/`` where there are masks, ``sparse/0``, ``posing.json`` and ``posing.png``;
    z is up as the cameras were held, and the cameras look at the origin. A call that was stopped is resumed, one
    that has finished is told again, as long as data and options are the same.

    Raises ComponentImportError where pycolmap is missing, DataError for photographs of no use, OutputError.
    """
    colmap.require_pycolmap()
    found = None if is_video(data) else find_photographs(data, besides=scene)
    files = [data] if found is None else [*found.paths, *(mask for mask in found.masks if mask is not None)]
    matters = {**asdict(replace(options, threads=None)), "names": [] if found is None else found.names}
    key = f"{fingerprint(files)} {json.dumps(matters)}"
    try:
        state = _begin(scene, key, (data if found is None else found.root).resolve(), announce)
        at_work = _Posing(data=data, scene=scene, options=options, announce=announce, state=state)
        if _is_model(scene / "sparse" / "0"):
            return read_outcome(scene)
        at_work.keep(state)
        return _carry_out(at_work, found)
    except OSError as error:
        raise cannot_write(Path(error.filename or scene), error) from error


def _carry_out(at_work: _Posing, found: Photographs | None) -> Outcome:
    work, options = at_work.work, at_work.options
    photographs = _frames(at_work) if found is None else _placed(found, at_work.scene)
    lenses = sort_by_lens(photographs, options.cameras)
    names = list(lenses.names)
    if len(names) < FEWEST:
        why = next(iter(lenses.unreadable.values()), "")
        raise DataError(
            f"{at_work.data}: {len(names)} of {len(photographs.names)} photographs can be read ({why}); expected "
            f"{FEWEST} or more."
        )
    images, database = work / "photographs", work / "database.db"
    for name, original in lenses.names.items():
        link_or_copy(photographs.root / original, images / name)
    masks = None if options.ignore_masks else _write_masks(photographs, lenses, work / "masks")
    colmap.extract(database, images, names, masks, options, at_work.tell("finding features"))
    at_work.keep(at_work.state)
    if masks is None and at_work.state.standing is None:
        at_work.keep(replace(at_work.state, standing=colmap.leave_out_standing(database, names)))
    for name in ("models", "all", "straight", "again"):
        shutil.rmtree(work / name, ignore_errors=True)
    pieces, compared = _placed_together(at_work, sorted(names, key=lenses.names.__getitem__), in_order=found is None)
    straight = bool(pieces) and colmap.diverged(pieces[0])
    if straight:
        again = at_work.tell("placing cameras again, with a straight lens")
        pieces = colmap.map_images(database, images, work / "straight", options, again, straight=True)
    elif pieces:
        again = at_work.tell("placing doubtful cameras again")
        pieces = best_explained(pieces, database, images, work / "again", options, again)
    models = join(pieces, database, images, work / "joined", straight=straight)
    seen = colmap.matched(database)
    if not models:
        raise nothing_placed(at_work.data, seen, len(lenses.unreadable), masks is not None)
    model = models[0] if straight else colmap.refined(models[0])
    left_out = reasons(seen, [sorted(colmap.world_to_cameras(each)) for each in models])
    notes = (*photographs.notes, *lenses.notes)
    if masks is not None:
        notes = (*notes, f"features are those inside the masks of {sum(m is not None for m in photographs.masks)}.")
    if at_work.state.standing is not None and at_work.state.standing[0]:
        notes = (*notes, _STANDING.format(*at_work.state.standing))
    if straight:
        notes = (*notes, _STRAIGHT)
    doubtful = [name for name in explained(model, database).below(_CONTRADICTED) if name not in left_out]
    if doubtful:
        notes = (*notes, _WRONG.format(listed([lenses.names[name] for name in doubtful])))
    if len(models) < len(pieces):
        notes = (*notes, f"{len(pieces)} pieces, of which {len(pieces) - len(models) + 1} are laid over each other.")
    outcome = Outcome(
        photographs=len(photographs.names),
        registered=len(colmap.world_to_cameras(model)),
        error_px=model.compute_mean_reprojection_error(),
        points=model.num_points3D(),
        cameras=tuple(_lens(camera) for _, camera in sorted(model.cameras.items())),
        compared=compared,
        models=tuple(each.num_reg_images() for each in models),
        left_out={**lenses.unreadable, **{lenses.names[name]: why for name, why in left_out.items()}},
        notes=notes,
        seconds=at_work.seconds,
    )
    _write(at_work, model, lenses, outcome)
    return outcome


def _placed_together(
    at_work: _Posing, names: Sequence[str], *, in_order: bool
) -> "tuple[list[pycolmap.Reconstruction], str]":
    """Models of the images, in the order of the photographs' names, and which were compared, in words.

    First by the likeliest pairs; where that does not place all in one model, by all that are to be compared.
    """
    work, options = at_work.work, at_work.options
    images, database = work / "photographs", work / "database.db"

    def mapped(pairs: Sequence[tuple[str, str]], what: str, folder: str) -> "list[pycolmap.Reconstruction]":
        colmap.match(database, pairs, options, at_work.tell(f"matching {what}"))
        at_work.keep(at_work.state)
        return colmap.map_images(database, images, work / folder, options, at_work.tell("placing cameras"))

    if not in_order and 2 * PARTNERS < len(names) <= EXHAUSTIVE_UP_TO:
        pieces = mapped(likely_pairs(database, names), "likely pairs", "models")
        if len(pieces) == 1 and pieces[0].num_reg_images() == len(names):
            return pieces, "each photograph with those that most likely show the same"
    pairs, compared = choose_pairs(len(names), in_order=in_order)
    return mapped([(names[first], names[second]) for first, second in pairs], "pairs", "all"), compared


def _begin(scene: Path, key: str, source: Path, announce: Announcer) -> _State:
    """The state to go on from. Raises OutputError where the folder holds something else."""
    inside = source == (scene / "images").resolve()
    new = _State(key=key, source=str(source), inside=inside)
    kept = scene / WORK / "state.json"
    if kept.is_file():
        try:
            said = json.loads(kept.read_text(encoding="utf-8"))
            # Earlier versions did not say whose the images are: then they may be the user's.
            whose = {"source": said.get("source", ""), "inside": said.get("inside", True)}
            found = said.get("standing")
            state = _State(
                key=said["key"],
                frames=tuple(said["frames"]),
                standing=None if found is None else (found[0], found[1]),
                seconds=said["seconds"],
                **whose,
            )
        except (ValueError, TypeError, KeyError, AttributeError):
            state = replace(new, key="", inside=True)
        if state.key == key:
            return replace(state, source=new.source, inside=inside)
        if state.inside and not inside:
            raise OutputError(
                f"{scene}: its images/ may be photographs that another call was given; give another folder, or remove "
                "this one if they are copies."
            )
        if not inside and state.source != new.source:
            raise OutputError(f"{scene}: holds the cameras of {state.source}; give another folder, or remove this one.")
        announce.say("photographs or options are not those of the last call: it is begun anew")
        # State last: what is left of a removal that was cut short is removed by the next call.
        for name in ("sparse", *(() if inside else ("images", "masks"))):
            shutil.rmtree(scene / name, ignore_errors=True)
        shutil.rmtree(scene / WORK, ignore_errors=True)
    elif scene.exists() and not (scene.is_dir() and _may_be_used(scene, inside)):
        raise OutputError(
            f"{scene}: exists and is not empty; give a new or an empty folder, the folder of an earlier posing, or the "
            "one whose images/ the photographs are."
        )
    (scene / WORK).mkdir(parents=True, exist_ok=True)
    return new


def _may_be_used(scene: Path, inside: bool) -> bool:
    if inside:
        return not (scene / "sparse").exists()
    # A call that was killed before it wrote its state leaves its folder behind.
    return all(path.name == WORK for path in scene.iterdir())


def _frames(at_work: _Posing) -> Photographs:
    """Frames of the video, in the scene's folder of images."""
    folder, names = at_work.scene / "images", at_work.state.frames
    if not names:
        footage = look_through(at_work.data, at_work.tell("looking through"))
        chosen = choose_frames(footage, at_work.options.frames)
        if len(chosen) < FEWEST:
            raise DataError(
                f"{at_work.data}: {len(footage.motion)} frames, of which {len(chosen)} differ; expected a video of a "
                "walk round the object."
            )
        names = tuple(write_frames(at_work.data, chosen, folder, at_work.tell("writing frames")))
        at_work.keep(replace(at_work.state, frames=names))
    return Photographs(root=folder, names=names, masks=(None,) * len(names))


def _placed(found: Photographs, scene: Path) -> Photographs:
    """The photographs and their masks inside the scene, where they are not there already; those that pycolmap does not
    read are converted."""
    foreign = [name for name in found.names if Path(name).suffix.lower() in CONVERTED]
    if not foreign and found.root.resolve() == (scene / "images").resolve():
        return found
    names, masks = [], list[Path | None]()
    for name, mask in zip(found.names, found.masks, strict=True):
        if name in foreign:
            names.append(f"{name}{_convert(found.root / name, scene / 'images' / name)}")
        else:
            names.append(name)
            link_or_copy(found.root / name, scene / "images" / name)
        masks.append(None if mask is None else link_or_copy(mask, scene / "masks" / f"{names[-1]}{mask.suffix}"))
    kinds = ", ".join(sorted({Path(name).suffix.lower()[1:] for name in foreign}))
    notes = found.notes
    if foreign:
        notes = (*notes, f"{len(foreign)} photographs ({kinds}) are written as JPEG or PNG.")
    return Photographs(root=scene / "images", names=tuple(names), masks=tuple(masks), notes=notes)


def _convert(source: Path, target: Path) -> str:
    """Write the image beside ``target``, unless it is there already; the suffix that is added to the name."""
    for suffix in CONVERSIONS:
        if target.with_name(target.name + suffix).exists():
            return suffix
    suffix, content = converted(source)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target.with_name(target.name + suffix), content)
    return suffix


def _write_masks(photographs: Photographs, lenses: Sorted, folder: Path) -> Path | None:
    """Masks as COLMAP reads them; None where there are none. Raises DataError for one that cannot be used."""
    by_name = dict(zip(photographs.names, photographs.masks, strict=True))
    jobs = [(name, mask) for name, original in lenses.names.items() if (mask := by_name[original]) is not None]

    def write(job: tuple[str, Path]) -> None:
        name, mask = job
        target = folder / f"{name}.png"
        if target.is_file():
            return
        width, height = lenses.sizes[name]
        coverage = read_mask(mask, (width, height), width, height)
        target.parent.mkdir(parents=True, exist_ok=True)
        _, data = cv2.imencode(".png", np.where(coverage >= 0.5, 255, 0).astype(np.uint8))
        write_atomically(target, data.tobytes())

    in_threads(write, jobs)
    return folder if jobs else None


def _write(at_work: _Posing, model: "pycolmap.Reconstruction", lenses: Sorted, outcome: Outcome) -> None:
    import pycolmap

    scene, work = at_work.scene, at_work.work
    poses = colmap.world_to_cameras(model)
    model.transform(pycolmap.Sim3d(upright_frame(np.array([poses[name] for name in sorted(poses)]))))
    for image in model.images.values():
        image.name = lenses.names[image.name]
    poses = np.array(list(colmap.world_to_cameras(model).values()))
    numbers = colmap.tracked(model).tolist()
    points = np.array([model.points3D[number].xyz for number in numbers]).reshape(-1, 3)
    colors = np.array([model.points3D[number].color for number in numbers], np.uint8).reshape(-1, 3)
    _, picture = cv2.imencode(".png", np.ascontiguousarray(draw_posing(poses, points, colors)[:, :, ::-1]))
    write_atomically(scene / PICTURE, picture.tobytes())
    write_atomically(scene / NAME, outcome.to_json().encode())
    shutil.rmtree(work / "model", ignore_errors=True)
    (work / "model").mkdir()
    model.write_binary(work / "model")
    # Last and at once: a model in its place says that all is there.
    (scene / "sparse").mkdir(exist_ok=True)
    os.replace(work / "model", scene / "sparse" / "0")


def _is_model(folder: Path) -> bool:
    return (folder / "images.bin").is_file()


def _lens(camera: "pycolmap.Camera") -> str:
    names: Sequence[str] = camera.params_info.split(", ")
    values = ", ".join(f"{name} {value:.4g}" for name, value in zip(names, camera.params, strict=True))
    return f"{camera.model.name} {camera.width}x{camera.height}: {values}"
