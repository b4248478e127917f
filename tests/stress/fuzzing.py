"""Bytes that were once a file of ours, and what reading them comes to."""

import random
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from sculpt_framework.errors import SculptError

SOON = 120
"""Seconds within which any answer comes, on a machine however busy: what takes longer hangs."""
KINDS = ("flip", "cut", "insert", "drop", "repeat", "swap", "number", "zero")
NUMBERS = (
    b"-1",
    b"1e999",
    b"NaN",
    b"99999999999999999999",
    b"null",
    b'""',
    b"[]",
    b"{}",
    b"0",
    b"1e-320",
    b"\x00",
    b"\xff",
)


@dataclass(frozen=True, kw_only=True)
class Target:
    """A kind of file and who reads it."""

    name: str
    path: Path
    original: bytes
    read: Callable[[], object]


def mutated(data: bytes, seed: int) -> bytes:
    """One to four changes, each anywhere."""
    chance = random.Random(seed)
    for _ in range(chance.randint(1, 4)):
        kind, at, size = chance.choice(KINDS), chance.randrange(len(data) + 1), chance.choice((1, 1, 3, 16, 300))
        if kind == "flip" and at < len(data):
            data = data[:at] + bytes([data[at] ^ (1 << chance.randrange(8))]) + data[at + 1 :]
        elif kind == "cut":
            data = data[:at]
        elif kind == "insert":
            data = data[:at] + chance.randbytes(size) + data[at:]
        elif kind == "drop":
            data = data[:at] + data[at + size :]
        elif kind == "repeat":
            data = data[: at + size] + data[at:]
        elif kind == "swap":
            other = chance.randrange(len(data) + 1)
            low, high = sorted((at, other))
            data = (
                data[:low] + data[high : high + size] + data[low + size : high] + data[low : low + size] + data[high:]
            )
        elif kind == "number":
            data = data[:at] + chance.choice(NUMBERS) + data[at + size :]
        else:
            data = data[:at] + bytes(min(size, len(data) - at)) + data[at + size :]
    return data


def outcome(target: Target, seed: int) -> str:
    """ "read", or "refused" with one line; whatever else is raised comes through."""
    target.path.write_bytes(mutated(target.original, seed))
    try:
        with answered_soon():
            target.read()
    except SculptError as error:
        if not is_one_line(error):
            raise
        return "refused"
    return "read"


@contextmanager
def answered_soon() -> Iterator[None]:
    """Raises TimeoutError for what hangs."""

    def give_up(number: int, frame: object) -> None:
        raise TimeoutError(f"no answer within {SOON} s")

    previous = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(SOON)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


def is_one_line(error: SculptError) -> bool:
    """Something is said, in one line."""
    return bool(str(error).strip()) and "\n" not in str(error).strip()
