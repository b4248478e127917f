"""Parameters that belong to named places (faces, cells, grid corners) and survive while their place does.

The set of places changes whenever the surface moves. A ``KeyedTable`` keeps, per integer key, a row of each of its
parameters *and the row's Adam state*, so that a place which is still there keeps everything exactly, and a new one
starts with its own bias correction. An Adam of whole tensors cannot: its step count is one.
"""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.adam import EPS, move_rows
from sculpt_framework.geometry.keys import locate


class KeyedTable:
    """Rows of named parameters under distinct integer keys, optimised by Adam.

    ``leaves`` are the rows as leaf tensors that collect gradients. Between ``rekey`` calls they stay the same objects.
    """

    def __init__(self, rates: Mapping[str, float], betas: tuple[float, float] = (0.9, 0.999)):
        """``rates`` are learning rates by the name of the parameter; one with rate 0 is kept but never changed."""
        self.rates = dict(rates)
        self.betas = betas
        self.keys: Int64[Tensor, " n"] = torch.empty(0, dtype=torch.int64)
        self.leaves: dict[str, Tensor] = {}
        self._first: dict[str, Tensor] = {}
        self._second: dict[str, Tensor] = {}
        self._steps: Float[Tensor, " n"] = torch.empty(0)

    def __len__(self) -> int:
        return self.keys.shape[0]

    @property
    def learning(self) -> list[Tensor]:
        """The leaves that collect gradients, in the order of the rates."""
        return [self.leaves[name] for name, rate in self.rates.items() if rate > 0 and name in self.leaves]

    def locate(self, keys: Int64[Tensor, " m"]) -> tuple[Int64[Tensor, " m"], Bool[Tensor, " m"]]:
        """Row of each key and whether it is in the table; the row of an absent key is arbitrary but valid."""
        # An empty table is on the CPU, wherever its rows will be.
        return locate(self.keys.to(keys.device), keys)

    def rekey(
        self,
        keys: Int64[Tensor, " m"],
        new_rows: Mapping[str, Float[Tensor, "m ..."]],
        heirs: tuple[Int64[Tensor, " p"], Int64[Tensor, " p"]] | None = None,
        located: tuple[Int64[Tensor, " m"], Bool[Tensor, " m"]] | None = None,
    ) -> None:
        """Make ``keys`` the table's keys, in this order.

        ``new_rows`` holds a full set of rows for ``keys``; only those of keys the table did not have are used. Rows and
        optimiser state of keys that are gone are dropped.

        ``heirs`` are pairs of a row of ``keys``, of a key the table does not have, and a row of the table. Such a key
        starts not with its new row but with the mean of the rows and of the optimiser state paired with it, and with as
        many steps as the oldest of them has.

        ``located`` is what ``locate`` says of the keys, if that is known.
        """
        if set(new_rows) != set(self.rates):
            raise ValueError(f"rows {sorted(new_rows)} do not match parameters {sorted(self.rates)}")
        if not self.rates:
            self.keys, self._steps = keys.clone(), torch.zeros(keys.shape[0], device=keys.device)
            return
        row, known = self.locate(keys) if located is None else located
        new, had_rows = (~known).nonzero()[:, 0], len(self) > 0
        if heirs is not None and len(heirs[0]) == 0:
            heirs = None
        for name, fresh in new_rows.items():
            values = fresh.detach().contiguous()
            first, second = torch.zeros_like(values), torch.zeros_like(values)
            if heirs is not None:
                values = _means(values, heirs, self.leaves[name].detach())
                first = _means(first, heirs, self._first[name])
                second = _means(second, heirs, self._second[name])
            if had_rows:
                values = _taken(self.leaves[name].detach(), row, new, values)
                first = _taken(self._first[name], row, new, first)
                second = _taken(self._second[name], row, new, second)
            self.leaves[name] = values.clone().requires_grad_(self.rates[name] > 0)
            self._first[name], self._second[name] = first, second
        steps = torch.zeros(keys.shape[0], device=keys.device)
        if heirs is not None:
            steps.scatter_reduce_(0, heirs[0], self._steps[heirs[1]], "amax")
        self._steps = _taken(self._steps, row, new, steps) if had_rows else steps
        self.keys = keys.clone()

    def keep_only(self, rates: Mapping[str, float]) -> None:
        """Drop all parameters but these, rows and optimiser state."""
        self.rates = dict(rates)
        for rows in (self.leaves, self._first, self._second):
            for name in rows.keys() - self.rates.keys():
                del rows[name]

    def zero_grad(self) -> None:
        for leaf in self.leaves.values():
            leaf.grad = None

    @torch.no_grad()
    def step(self, rate_factor: float = 1.0, eps: float = EPS, still: Bool[Tensor, " n"] | None = None) -> None:
        """One Adam step with the rows' own step counts; what has no gradient stays, and so do ``still`` rows."""
        if all(leaf.grad is None for leaf in self.leaves.values()):
            return
        self._steps += 1
        for name, leaf in self.leaves.items():
            if leaf.grad is None:
                continue
            kept = leaf[still] if still is not None else None
            moments = (self._first[name], self._second[name])
            move_rows(leaf, leaf.grad, *moments, self._steps, rate_factor * self.rates[name], self.betas, eps)
            if kept is not None:
                leaf[still] = kept

    def state(self) -> dict[str, Tensor]:
        """Everything as named tensors, for a checkpoint."""
        out = {"keys": self.keys, "steps": self._steps}
        for name, leaf in self.leaves.items():
            out[f"value.{name}"] = leaf.detach()
            out[f"first.{name}"] = self._first[name]
            out[f"second.{name}"] = self._second[name]
        return out

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``. Raises KeyError where an entry is missing."""
        self.keys, self._steps = state["keys"].clone(), state["steps"].clone()
        if len(self) == 0:
            self.leaves, self._first, self._second = {}, {}, {}
            return
        for name, rate in self.rates.items():
            self.leaves[name] = state[f"value.{name}"].clone().requires_grad_(rate > 0)
            self._first[name] = state[f"first.{name}"].clone()
            self._second[name] = state[f"second.{name}"].clone()


def _taken(
    table: Float[Tensor, "n ..."],
    row: Int64[Tensor, " m"],
    new: Int64[Tensor, " p"],
    others: Float[Tensor, "m ..."],
) -> Float[Tensor, "m ..."]:
    """Rows of the table, but for the places ``new``, which take theirs from ``others``."""
    return table.index_select(0, row).index_copy_(0, new, others.index_select(0, new))


def _means(
    rows: Float[Tensor, "m ..."],
    heirs: tuple[Int64[Tensor, " p"], Int64[Tensor, " p"]],
    table: Float[Tensor, "n ..."],
) -> Float[Tensor, "m ..."]:
    """``rows``, but for those paired with rows of the table: these are the means of theirs."""
    heir, lender = heirs
    count = torch.bincount(heir, minlength=rows.shape[0]).reshape(-1, *([1] * (rows.ndim - 1)))
    summed = torch.zeros_like(rows).index_add(0, heir, table.index_select(0, lender))
    return torch.where(count > 0, summed / count.clamp(min=1), rows)
