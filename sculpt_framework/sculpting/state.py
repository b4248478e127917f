"""The whole state of the optimisation as named tensors: for checkpoints, for keeping the best, for recovery."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from sculpt_framework.sculpting.trainer import BiLevelTrainer


def capture(trainer: BiLevelTrainer, stage: int, generator: torch.Generator) -> dict[str, Tensor]:
    """Copies of everything the next step depends on; ``stage`` is the index of the stage the trainer is in."""
    if trainer.seeds is None:
        raise ValueError("nothing to capture before the first surface")
    state: dict[str, Tensor] = {
        "stage": torch.tensor(stage),
        "seeds": trainer.seeds,
        "random": generator.get_state(),
        "view_order": torch.tensor(trainer.views.order, dtype=torch.int64),
        "inner_total": torch.tensor(trainer.inner_total),
    }
    _put(state, "field", trainer.field.state_dict())
    _put(state, "field_optimizer", trainer.optimizer.state())
    _put(state, "appearance", trainer.scene.appearance.state_dict())
    if trainer.scene.shared_optimizer is not None:
        _put(state, "appearance_optimizer", trainer.scene.shared_optimizer.state())
    for name, table in trainer.extractor.tables.items():
        _put(state, f"extractor.{name}", table.state())
    _put(state, "scene", trainer.scene.state())
    _put(state, "terms", trainer.own.state())
    _put(state, "resting", trainer.gating.state())
    if trainer.background is not None:
        _put(state, "background", trainer.background.state())
    return {name: tensor.detach().clone().contiguous() for name, tensor in state.items()}


def restore(trainer: BiLevelTrainer, generator: torch.Generator, state: Mapping[str, Tensor]) -> None:
    """Inverse of ``capture``, wherever the state lies; the extractor must already be on the captured stage's level.

    Raises KeyError where an entry is missing.
    """
    device = next(trainer.field.parameters()).device
    # The surface of another state: what follows must extract its own.
    trainer.extraction = None
    trainer.seeds = state["seeds"].to(device).clone()
    trainer.views.order = state["view_order"].tolist()
    trainer.inner_total = int(state["inner_total"])
    generator.set_state(state["random"].clone())
    _load_module(trainer.field, _get(state, "field"))
    trainer.optimizer.load_state(_get(state, "field_optimizer"))
    _load_module(trainer.scene.appearance, _get(state, "appearance"))
    if trainer.scene.shared_optimizer is not None:
        trainer.scene.shared_optimizer.load_state(_get(state, "appearance_optimizer"))
    for name, table in trainer.extractor.tables.items():
        table.load_state(_moved(_get(state, f"extractor.{name}"), device))
    trainer.scene.load_state(_moved(_get(state, "scene"), device))
    trainer.own.load_state(_get(state, "terms"))
    trainer.gating.load_state(_get(state, "resting"))
    if trainer.background is not None:
        trainer.background.load_state(_get(state, "background"))


def _load_module(module: nn.Module, state: Mapping[str, Tensor]) -> None:
    module.load_state_dict(dict(state))


@contextmanager
def undisturbed(trainer: BiLevelTrainer) -> Iterator[None]:
    """Afterwards the next step is what it would have been, to the bit, whatever surfaces were extracted meanwhile.

    An extraction forgets the parameters of corners it does not visit, and from other seeds it visits the same corners
    in another order, which rounds otherwise.
    """
    seeds, extraction = trainer.seeds, trainer.extraction
    tables = {name: table.state() for name, table in trainer.extractor.tables.items()}
    rows = trainer.scene.state()
    try:
        yield
    finally:
        trainer.seeds, trainer.extraction = seeds, extraction
        for name, table in trainer.extractor.tables.items():
            table.load_state(tables[name])
        trainer.scene.load_state(rows)


def _put(state: dict[str, Tensor], prefix: str, entries: Mapping[str, Tensor]) -> None:
    for name, value in entries.items():
        state[f"{prefix}/{name}"] = value


def _get(state: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name[len(prefix) + 1 :]: value for name, value in state.items() if name.startswith(f"{prefix}/")}


def _moved(state: Mapping[str, Tensor], device: torch.device) -> dict[str, Tensor]:
    return {name: value.to(device) for name, value in state.items()}
