"""The same work on many things, in the threads that torch has: numpy, torch and OpenCV let each other work."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

Item = TypeVar("Item")
Done = TypeVar("Done")


def in_threads(work: Callable[[Item], Done], items: Iterable[Item]) -> list[Done]:
    """What ``work`` makes of each item, in their order. Raises what it raises first."""
    with ThreadPoolExecutor(max_workers=torch.get_num_threads()) as pool:
        return list(pool.map(work, items))
