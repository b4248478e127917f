"""Looking up keys in lists of others."""

import pytest
import torch
from torch import Tensor

from sculpt_framework.geometry.keys import find, locate, merging

NOTHING = torch.empty(0, dtype=torch.int64)


def some_keys(count: int, seed: int) -> Tensor:
    """Distinct, ascending, over the whole range of keys."""
    return torch.randint(1 << 60, (count,), generator=torch.Generator().manual_seed(seed)).unique()


def test_find():
    row, there = find(torch.tensor([2, 5, 9]), torch.tensor([9, 3, 2, 11]))
    assert there.tolist() == [True, False, True, False]
    assert row[there].tolist() == [2, 0]
    assert find(NOTHING, torch.tensor([1]))[1].tolist() == [False]


@pytest.mark.parametrize("runs", [1, 3, 100])
def test_locate_in_lists_of_several_ascending_runs(runs: int):
    keys = some_keys(500, seed=0)
    held, gone = keys[::2], keys[1::2]
    among = torch.cat([held[n::runs] for n in range(runs)])
    row, there = locate(among, torch.cat([gone, held.flip(0)]))
    assert there.tolist() == [False] * len(gone) + [True] * len(held)
    assert torch.equal(among[row[there]], held.flip(0))
    assert bool(((row >= 0) & (row < len(among))).all())


def test_locate_in_nothing():
    assert locate(NOTHING, torch.tensor([3, 1]))[1].tolist() == [False, False]
    assert locate(torch.tensor([3, 1]), NOTHING)[0].shape == (0,)


@pytest.mark.parametrize(("first", "second"), [(300, 0), (300, 1), (300, 200), (0, 5), (0, 0)])
def test_merging_sorts_both(first: int, second: int):
    keys = some_keys(first + second, seed=1)
    mixed = keys[torch.randperm(len(keys), generator=torch.Generator().manual_seed(2))]
    ascending, rest = mixed[:first].sort().values, mixed[first:]
    order = merging(ascending, rest)
    assert torch.equal(torch.cat([ascending, rest])[order], keys)
