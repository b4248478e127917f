"""``sculpt-train``: from the command line to a run.

Up to the start of training nothing here imports torch: help, mistakes in options and the number of threads, which the
runtime libraries read when they are loaded, all come before.
"""

import gc
import os
import sys
from dataclasses import replace

from sculpt_framework.cli import exit_codes
from sculpt_framework.command_line.request import read_request
from sculpt_framework.config import MethodConfig
from sculpt_framework.cores import usable_cores
from sculpt_framework.engine.clock import process_start
from sculpt_framework.engine.output import check_output
from sculpt_framework.errors import DeviceError
from sculpt_framework.memory import collector_paused


def main() -> None:
    """The console script ``sculpt-train``."""
    exit_codes.run(train)


def train() -> None:
    """Parse, check, train. Raises SculptError."""
    started = process_start()
    request = read_request(sys.argv[1:])
    # Of several processes (torchrun) the first makes the folder, and another may come later.
    if request.resume is None and os.environ.get("RANK", "0") == "0":
        check_output(request.config)
    limit_threads(request.config.threads)
    check_device(request.config)

    with collector_paused():
        from sculpt_framework.engine.run import run
    # What is loaded stays: the collector need not look through it again in the middle of training.
    gc.freeze()
    run(with_absolute_paths(request.config), resume=request.resume, started=started)


def limit_threads(threads: int | None) -> None:
    """Tell the numerical libraries how many threads to use; they read it when they are first imported.

    By default all cores this process may use, unless the environment says otherwise.
    """
    for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        if threads is not None:
            os.environ[variable] = str(threads)
        else:
            os.environ.setdefault(variable, os.environ.get("OMP_NUM_THREADS", str(usable_cores())))


def check_device(config: MethodConfig) -> None:
    """Raise DeviceError if CUDA is asked for and absent."""
    if config.device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise DeviceError(
            "--device cuda: torch finds no CUDA device here. Use --device cpu or auto, or install a torch with CUDA."
        )


def with_absolute_paths(config: MethodConfig) -> MethodConfig:
    """The config with paths that hold wherever it is resumed from. Names of demo scenes stay what they are."""
    is_path = config.data.partition(":")[0] != "demo" and os.path.exists(config.data)
    data = os.path.abspath(config.data) if is_path else config.data
    reference, replay = (path and path.absolute() for path in (config.reference, config.replay))
    return replace(config, data=data, reference=reference, replay=replay)


if __name__ == "__main__":
    main()
