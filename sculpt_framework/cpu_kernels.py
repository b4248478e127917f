"""What all numba kernels share: where their machine code is kept, the time it takes to make, the
number of threads, and tensors as they take them."""

import hashlib
import logging
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from sculpt_framework.memory import collector_paused
from sculpt_framework.user_cache import user_cache

with collector_paused():
    import numba
    from numba.core import event as numba_event
    from numba.core.registry import cpu_target

# numba makes the attributes of its config when it is loaded, which the checker does not see.
# pyright: reportAttributeAccessIssue=false, reportPrivateImportUsage=false


@contextmanager
def kernel_cache(name: str, *sources: Path) -> Iterator[None]:
    """Kernels defined inside keep their machine code in a folder of the user's, one per state of ``sources``.

    ``sources`` are Python files or folders of them. numba alone looks at the file a kernel is written in, and would
    go on using code that was compiled with constants another file no longer has. A cache folder the user has set
    (NUMBA_CACHE_DIR) is left as it is. Says so, once, when nothing is compiled yet.
    """
    if numba.config.CACHE_DIR:
        yield
        return
    folder = _user_folder() / f"{name}-{_digest(*sources)}"
    if not folder.is_dir():
        message = "compiling the CPU kernels of '%s' on first use, kept in %s"
        logging.getLogger("sculpt").info(message, name, folder)
    numba.config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = ""


def load_numba() -> None:
    """Load what numba else loads at the first call of any kernel: here no garbage is collected meanwhile."""
    with collector_paused():
        cpu_target.target_context.refresh()


class CompileSeconds:
    """Wall seconds that numba has spent compiling while this was entered; kernels from the cache cost none.

    To be asked between kernels: one that is being compiled does not count yet.
    """

    def __init__(self) -> None:
        self._listener = numba_event.TimingListener()

    def __enter__(self) -> "CompileSeconds":
        numba_event.register("numba:compile", self._listener)
        return self

    def __exit__(self, *raised: object) -> None:
        numba_event.unregister("numba:compile", self._listener)

    def __call__(self) -> float:
        return self._listener.duration if self._listener.done else 0.0


def _user_folder() -> Path:
    """The user's cache folder, or one under the system's temporary folder where home is read-only."""
    candidate = user_cache()
    try:
        candidate.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=candidate).close()
    except OSError:
        # On Windows that folder is the user's own.
        owner = "" if sys.platform == "win32" else f"-{os.getuid()}"
        return Path(tempfile.gettempdir()) / f"gaussian-sculpting{owner}"
    return candidate


def _digest(*sources: Path) -> str:
    files = [file for each in sources for file in (sorted(each.glob("*.py")) if each.is_dir() else [each])]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()[:12]


def share_threads() -> int:
    """Let numba use as many threads as torch does, and return how many those are.

    Both often run on the same OpenMP runtime, whose thread count numba sets to all cores when it starts up.
    """
    wanted = torch.get_num_threads()
    threads = min(wanted, numba.config.NUMBA_NUM_THREADS)
    numba.set_num_threads(threads)
    if torch.get_num_threads() != wanted:
        torch.set_num_threads(wanted)
    return threads


def float32_on_cpu(*tensors: torch.Tensor) -> bool:
    """Whether kernels take these tensors: what has a twin in torch runs there otherwise."""
    return all(tensor.dtype == torch.float32 and tensor.device.type == "cpu" for tensor in tensors)


def array_of(tensor: torch.Tensor) -> np.ndarray:
    """The numbers of a tensor on the CPU, without gradient, one after the other; shared with it if they lie so."""
    return tensor.detach().contiguous().numpy()
