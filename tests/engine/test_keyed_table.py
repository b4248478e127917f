"""Laws of rows under keys."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from sculpt_framework.keyed import KeyedTable

RATES = {"place": 0.1, "colour": 0.01, "fixed": 0.0}


def rows(count: int, fill: float = 0.0) -> dict[str, Tensor]:
    return {
        "place": torch.full((count, 3), fill),
        "colour": torch.full((count, 2, 3), fill),
        "fixed": torch.full((count,), fill),
    }


def table_of(keys: list[int], fill: float = 0.0) -> KeyedTable:
    table = KeyedTable(RATES)
    table.rekey(torch.tensor(keys, dtype=torch.int64), rows(len(keys), fill))
    return table


def pull(table: KeyedTable, generator: torch.Generator) -> None:
    """A step along a random gradient."""
    table.zero_grad()
    for name, leaf in table.leaves.items():
        if RATES[name] > 0:
            leaf.grad = torch.randn(leaf.shape, generator=generator)
    table.step()


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.integers(-(2**62), 2**62), min_size=1, max_size=12, unique=True),
    st.lists(st.integers(-(2**62), 2**62), min_size=1, max_size=12, unique=True),
    st.randoms(use_true_random=False),
)
def test_kept_keys_keep_everything_and_new_ones_start_anew(first: list[int], more: list[int], random):
    table = table_of(first)
    pull(table, torch.Generator().manual_seed(1))
    pull(table, torch.Generator().manual_seed(2))
    old = {key: {n: v[i].clone() for n, v in table.state().items()} for i, key in enumerate(first)}
    keys = list(dict.fromkeys([key for key in first if random.random() < 0.5] + more))
    random.shuffle(keys)
    table.rekey(torch.tensor(keys, dtype=torch.int64), rows(len(keys), fill=7.0))
    assert table.keys.tolist() == keys
    for index, key in enumerate(keys):
        now = {name: value[index] for name, value in table.state().items()}
        if key in old:
            assert all(torch.equal(now[name], old[key][name]) for name in now)
        else:
            assert now["steps"] == 0
            assert all(bool((now[n] == 7.0).all()) for n in now if n.startswith("value."))
            assert not any(bool(now[n].any()) for n in now if n.startswith(("first.", "second.")))


def test_equals_adam_while_keys_stay():
    table = table_of([5, -3, 9], fill=0.5)
    twin = torch.full((3, 3), 0.5, requires_grad=True)
    adam = torch.optim.Adam([twin], lr=RATES["place"], eps=1e-15)
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        gradient = torch.randn(3, 3, generator=generator)
        table.leaves["place"].grad, twin.grad = gradient.clone(), gradient.clone()
        table.step()
        adam.step()
    torch.testing.assert_close(table.leaves["place"], twin, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("shape", [(), (1,), (2, 3)])
def test_the_kernel_is_the_twin(shape: tuple[int, ...]):
    generator = torch.Generator().manual_seed(3)
    count = 700
    table, values = KeyedTable({"row": 0.05}), torch.randn(count, *shape, generator=generator)
    table.rekey(torch.arange(count), {"row": values})
    for _ in range(2):
        table.leaves["row"].grad = torch.randn(count, *shape, generator=generator)
        table.step()
    # Half of the rows are new: they have other numbers of steps.
    table.rekey(torch.arange(count) + count // 2, {"row": values})
    twin = KeyedTable({"row": 0.05})
    twin.rekey(table.keys, {"row": values.double()})
    twin.load_state({n: v.double() if v.is_floating_point() else v for n, v in table.state().items()})
    for _ in range(3):
        gradient = torch.randn(count, *shape, generator=generator) * 1e-3
        gradient[:5] = 0.0
        table.leaves["row"].grad = gradient
        table.step(rate_factor=0.3, eps=1e-15)
        twin.leaves["row"].grad = gradient.double()
        twin.step(rate_factor=0.3, eps=1e-15)
    for name, tensor in table.state().items():
        torch.testing.assert_close(tensor.double(), twin.state()[name].double(), rtol=1e-4, atol=1e-6)


def test_a_graph_of_values_before_a_step_is_refused():
    table = table_of([1, 2], fill=1.0)
    loss = table.leaves["place"].square().sum()
    table.leaves["place"].grad = torch.ones(2, 3)
    table.step()
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_a_new_row_has_its_own_bias_correction():
    table = table_of([1])
    for _ in range(50):
        table.leaves["place"].grad = torch.ones(1, 3)
        table.step()
    table.rekey(torch.tensor([1, 2]), rows(2))
    start = table.leaves["place"].detach().clone()
    table.zero_grad()
    table.leaves["place"].grad = torch.full((2, 3), 1e-3)
    table.step()
    # Adam's first step has the length of the rate, whatever the gradient's.
    torch.testing.assert_close(start[1] - table.leaves["place"][1].detach(), torch.full((3,), RATES["place"]))


def test_what_has_no_gradient_or_no_rate_stays():
    table = table_of([1, 2], fill=3.0)
    assert not table.leaves["fixed"].requires_grad
    table.leaves["place"].grad = torch.ones(2, 3)
    table.step()
    assert bool((table.leaves["colour"] == 3.0).all())
    assert bool((table.leaves["fixed"] == 3.0).all())
    before = table.state()["steps"].clone()
    table.zero_grad()
    table.step()
    assert torch.equal(table.state()["steps"], before)


def test_state_goes_round():
    table = table_of([4, 1, 3])
    generator = torch.Generator().manual_seed(0)
    pull(table, generator)
    saved = {name: value.clone() for name, value in table.state().items()}
    twin = KeyedTable(RATES)
    twin.load_state(saved)
    pull(table, torch.Generator().manual_seed(5))
    pull(twin, torch.Generator().manual_seed(5))
    for name, value in table.state().items():
        assert torch.equal(value, twin.state()[name])
    with pytest.raises(KeyError):
        twin.load_state({name: value for name, value in saved.items() if name != "first.place"})


def test_empty_tables_and_wrong_names():
    table = KeyedTable(RATES)
    assert len(table) == 0
    assert not table.locate(torch.tensor([1, 2]))[1].any()
    table.rekey(torch.empty(0, dtype=torch.int64), rows(0))
    table.rekey(torch.tensor([1]), rows(1))
    with pytest.raises(ValueError, match="do not match"):
        table.rekey(torch.tensor([1]), {"place": torch.zeros(1, 3)})
