"""How much memory this process has used, and may still have: of the machine, and under the limits it runs with."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

if sys.platform != "win32":
    import resource

_GROUPS = (
    # Mount of the hierarchy, names of its files for the limit and the use, and what of the use can be taken back.
    ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"),
    ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)


def available_bytes(root: Path = Path("/")) -> int | None:
    """What this process may take on before the machine swaps or refuses; None where the system does not tell.

    The least of what the machine has left, of what control groups leave (containers, batch systems), and of the limit
    on address space (``ulimit -v``). Files of the system are looked up under ``root``.
    """
    known = [*_of_machine(root), *_of_groups(root), *_of_limits(root)]
    return max(0, min(known)) if known else None


def peak_bytes(root: Path = Path("/")) -> int:
    """Most memory that this process has had in use so far.

    The system's own count of it (``ru_maxrss``) begins with what the process that started this one had in use; Linux
    has another that does not.
    """
    for line in _lines(root / "proc/self/status"):
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) << 10
    if sys.platform == "win32":
        import psutil

        return psutil.Process().memory_info().peak_wset
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 2**10)


@contextmanager
def collector_paused() -> Iterator[None]:
    """No garbage is collected inside. For loading libraries, all of which stays: looking through it over and over
    takes a fifth of the time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def in_words(size: int | float) -> str:
    """A number of bytes for people."""
    return f"{size / 2**30:.1f} GiB" if size >= 0.95 * 2**30 else f"{size / 2**20:.0f} MiB"


def _of_machine(root: Path) -> Iterator[int]:
    for line in _lines(root / "proc/meminfo"):
        if line.startswith("MemAvailable:"):
            yield int(line.split()[1]) << 10
    if sys.platform != "linux" and root == Path("/"):
        import psutil

        yield psutil.virtual_memory().available


def _of_groups(root: Path) -> Iterator[int]:
    """Of every group this process is in, up to the root of its hierarchy."""
    for line in _lines(root / "proc/self/cgroup"):
        number, controllers, path = line.split(":", 2)
        if number != "0" and "memory" not in controllers.split(","):
            continue
        mount, limit_name, use_name, idle_name = _GROUPS[0 if number == "0" else 1]
        # In a container the path is often that of the host, which does not exist inside: its root then is the mount.
        for group in (PurePosixPath(path.lstrip("/")), *PurePosixPath(path.lstrip("/")).parents):
            folder = root / mount / group
            limit, use = _lines(folder / limit_name), _lines(folder / use_name)
            if limit and use and limit[0].isdigit() and use[0].isdigit():
                yield int(limit[0]) - int(use[0]) + _idle(folder, idle_name)


def _idle(folder: Path, name: str) -> int:
    """Pages of files that are only kept while nobody needs the memory."""
    return next((int(line.split()[1]) for line in _lines(folder / "memory.stat") if line.split()[0] == name), 0)


def _of_limits(root: Path) -> Iterator[int]:
    if sys.platform == "win32":
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    used = _lines(root / "proc/self/statm")
    if limit != resource.RLIM_INFINITY and used:
        yield limit - int(used[0].split()[0]) * resource.getpagesize()


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return []


def peak_megabytes() -> float:
    """Peak resident memory of this process, MiB."""
    return peak_bytes() / 2**20
