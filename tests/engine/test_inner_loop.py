"""What an inner loop leaves out: steps that no longer lower its loss, and faces that have not moved."""

import math
from dataclasses import replace

import pytest
import torch
from small_runs import ONE_STAGE, on_a_sphere, small_config
from torch import Tensor

from sculpt_framework.losses import TrainingImage
from sculpt_framework.sculpting.assembly import Parts
from sculpt_framework.sculpting.config import TrainerConfig
from sculpt_framework.sculpting.plateau import Plateau
from sculpt_framework.sculpting.still_faces import StillFaces
from sculpt_framework.types import Scene, Surface
from sculpt_plugins.appearances.per_gaussian.config import PerGaussianConfig
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig

CELL = 0.1


# -- whether a loss falls ----------------------------------------------------------------------------------------------


def evaluations(plateau: Plateau, losses: list[float]) -> int:
    """How many of the losses are asked for."""
    for count, loss in enumerate(losses, 1):
        if not plateau.after(loss):
            return count
    return len(losses) + 1


@pytest.mark.parametrize(
    ("factor", "passes"),
    [(0.5, 6), (0.89, 6), (0.91, 2), (1.0, 2), (1.5, 2)],
)
def test_a_pass_has_to_lower_the_loss(factor: float, passes: int):
    """By a tenth; views of a pass differ by far more than that."""
    losses = [view * factor**number for number in range(6) for view in (1.0, 20.0, 3.0)]
    assert evaluations(Plateau(3, gain=0.1), losses) == 3 * passes + (passes == 6)


def test_it_ends_once_the_loss_has_stopped_to_fall():
    losses = [1.0] * 4 + [0.5] * 4 + [0.25] * 4 + [0.249] * 4 + [0.1] * 4
    assert evaluations(Plateau(4, gain=0.05), losses) == 16


def test_without_a_gain_it_never_ends():
    assert evaluations(Plateau(1, gain=0.0), [1.0, 2.0, 4.0]) == 4


def test_batches_count_as_many_as_they_have():
    plateau = Plateau(4, gain=0.1)
    assert [plateau.after(1.0, 2) for _ in range(4)] == [True, True, True, False]


def test_what_is_not_finite_does_not_fall():
    plateau = Plateau(1, gain=0.1)
    assert plateau.after(1.0)
    assert not plateau.after(math.nan)


# -- which faces have moved --------------------------------------------------------------------------------------------


def strip(count: int, offset: Tensor | None = None, first: int = 0) -> Surface:
    """Faces that have no corner in common, each moved by its own offset."""
    base = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    keys = torch.arange(first, first + count)
    corners = base + keys[:, None, None] * torch.tensor([2.0, 0.0, 0.0])
    if offset is not None:
        corners = corners + offset[:, None, None] * torch.tensor([0.0, 0.0, 1.0])
    return Surface(vertices=corners.reshape(-1, 3), faces=torch.arange(3 * count).reshape(-1, 3), face_keys=7 * keys)


def moving(still: StillFaces, surface: Surface) -> list[int] | None:
    found = still.moving(surface, CELL)
    return None if found is None else found.nonzero()[:, 0].tolist()


def test_faces_learn_at_first_and_where_they_have_moved():
    still = StillFaces(0.5)
    assert moving(still, strip(3)) is None
    assert moving(still, strip(3)) == []
    assert moving(still, strip(3, torch.tensor([0.0, 0.049, 0.051]))) == [2]


def test_small_moves_add_up():
    still = StillFaces(0.5)
    moving(still, strip(1))
    found = [moving(still, strip(1, torch.tensor([0.02 * step]))) for step in range(1, 8)]
    assert found == [[], [], [0], [], [], [0], []]


def test_new_faces_learn_and_old_ones_are_known_by_their_keys():
    still = StillFaces(0.5)
    moving(still, strip(4))
    assert moving(still, strip(4, first=2)) == [2, 3]
    assert moving(still, strip(4)) == [0, 1]


def test_a_face_of_which_nothing_is_known_is_not_still():
    still = StillFaces(0.5)
    moving(still, strip(2))
    assert moving(still, strip(2, torch.tensor([0.0, math.nan]))) == [1]
    assert moving(still, strip(2)) == [1]


def test_without_a_bound_all_faces_learn():
    still = StillFaces(0.0)
    assert [moving(still, strip(2)) for _ in range(2)] == [None, None]
    assert still.state() == {}


def test_what_is_remembered_can_be_saved_and_forgotten():
    still, other = StillFaces(0.5), StillFaces(0.5)
    moving(still, strip(3))
    other.load_state(still.state())
    assert moving(other, strip(3)) == []
    other.load_state({})
    assert moving(other, strip(3)) is None
    still.forget()
    assert moving(still, strip(3)) is None


def test_an_empty_surface_has_no_face_that_moves():
    still = StillFaces(0.5)
    moving(still, strip(2))
    assert moving(still, strip(0)) == []
    assert moving(still, strip(2)) is None


# -- in the loop -------------------------------------------------------------------------------------------------------


def start(scene: Scene, **changes: object) -> tuple[Parts, list[TrainingImage], Surface]:
    """Components on a sphere with the Gaussians on it, and images to learn from."""
    parts, images = on_a_sphere(small_config(**changes), scene)
    surface = parts.trainer.extract().surface.detach()
    parts.trainer.scene.follow(surface)
    return parts, images, surface


def rows(parts: Parts) -> dict[str, Tensor]:
    scene = parts.trainer.scene
    return {**scene.geometry_rows.leaves, **scene.appearance_rows.leaves}


def test_only_gaussians_of_moving_faces_learn(scene: Scene):
    learned = FaceBarycentricConfig(places="learned")
    parts, images, surface = start(scene, appearance=PerGaussianConfig(), binder=learned)
    still = torch.arange(len(surface.faces)) % 3 != 0
    before = {name: leaf.detach().clone() for name, leaf in rows(parts).items()}
    # Adam would go on with rows that have moved before.
    parts.trainer.inner_loop(surface, images, steps=6, rate_factor=1.0)
    middle = {name: leaf.detach().clone() for name, leaf in rows(parts).items()}
    assert all(not torch.equal(value, before[name]) for name, value in middle.items() if "band" not in name)
    parts.trainer.inner_loop(surface, images, steps=6, rate_factor=1.0, moving=~still)
    for name, leaf in rows(parts).items():
        assert torch.equal(leaf[still], middle[name][still]), name
    color = parts.trainer.scene.appearance_rows.leaves
    assert any(not torch.equal(leaf[~still], middle[name][~still]) for name, leaf in color.items())


def test_all_faces_moving_is_as_none_named(scene: Scene):
    outcomes = []
    for named in (False, True):
        parts, images, surface = start(scene)
        faces = torch.ones(len(surface.faces), dtype=torch.bool) if named else None
        loss, _ = parts.trainer.inner_loop(surface, images, steps=4, rate_factor=1.0, moving=faces)
        outcomes.append((loss, *(leaf.detach().clone() for leaf in parts.trainer.scene.appearance.parameters())))
    assert outcomes[0][0] == outcomes[1][0]
    for first, second in zip(outcomes[0][1:], outcomes[1][1:], strict=True):
        torch.testing.assert_close(first, second)


def test_where_nothing_moves_there_is_no_inner_step(scene: Scene):
    parts, images, _ = start(scene, still_cells=0.02)
    trainer, stage = parts.trainer, ONE_STAGE[0]
    assert trainer.settle(images, stage, 1.0).inner_loss is not None
    taken = trainer.inner_total
    assert taken == stage.inner_steps
    settled = trainer.settle(images, stage, 1.0)
    assert settled.inner_loss is None
    assert trainer.inner_total == taken
    report = trainer.update(settled, images, stage, 1.0)
    assert math.isfinite(report.loss)
    # Everything has moved now: Adam's first step is a full one.
    assert trainer.settle(images, stage, 1.0).inner_loss is not None
    assert trainer.inner_total == 2 * taken


def test_gaussians_that_have_never_learned_are_not_left_out(scene: Scene):
    parts, images, _ = start(scene, still_cells=0.02)
    trainer = parts.trainer
    for steps in (0, 2):
        trainer.settle(images, replace(ONE_STAGE[0], inner_steps=steps), 1.0)
        assert trainer.inner_total == steps


def test_other_images_are_learned_from_whatever_has_moved(scene: Scene):
    parts, images, _ = start(scene, still_cells=0.02)
    trainer, stage = parts.trainer, ONE_STAGE[0]
    for step in (1, 2):
        trainer.begin_stage()
        trainer.settle(images, stage, 1.0)
        assert trainer.inner_total == step * stage.inner_steps


def test_a_cold_start_learns_everything_anew(scene: Scene):
    parts, images, _ = start(scene, still_cells=0.02, warm_start=False)
    trainer, stage = parts.trainer, ONE_STAGE[0]
    for step in (1, 2):
        assert trainer.settle(images, stage, 1.0).inner_loss is not None
        assert trainer.inner_total == step * stage.inner_steps


def test_an_inner_loop_ends_where_it_gains_nothing(scene: Scene):
    stage = replace(ONE_STAGE[0], inner_steps=400)
    taken = []
    for gain in (0.9, 0.0):
        parts, images, _ = start(scene, inner_gain=gain)
        parts.trainer.settle(images, stage, 1.0)
        taken.append(parts.trainer.inner_total)
    assert taken == [100, 400]


def test_both_are_off_unless_a_method_says_otherwise():
    fields = TrainerConfig.__dataclass_fields__
    assert (fields["inner_gain"].default, fields["still_cells"].default) == (0.0, 0.0)
