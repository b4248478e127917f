"""How a command ends: 0 done; 2 the user can mend it, 1 training failed, each with one line on stderr; 130 interrupted.

Where memory does not suffice a line says what needs less. A fault of ours keeps its traceback.
"""

import os
import sys
from collections.abc import Callable

from sculpt_framework.errors import SculptError, TrainingFailed

_OUT_OF_MEMORY = ("can't allocate memory", "not enough memory", "CUDA out of memory")
"""What torch's allocators say."""


def run(main: Callable[[], None]) -> None:
    """Run a command. SculptError and TrainingFailed become one line on stderr; any other error keeps its traceback."""
    try:
        main()
    except (SculptError, TrainingFailed) as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        sys.exit(2 if isinstance(error, SculptError) else 1)
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        asked = f" ({str(error).splitlines()[0]})" if str(error) else ""
        sys.stderr.write(
            f"error: memory does not suffice{asked}; lower --trainer.stages.N.image-scale or --trainer.stages.N.level, "
            "or give fewer or smaller images. --resume goes on from the last checkpoint.\n"
        )
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # Whoever reads our output has seen enough, as in ``sculpt-train METHOD --help | head``. Python flushes stdout
        # once more at exit, which must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


def is_out_of_memory(error: Exception) -> bool:
    """Whether the system or the device refused memory; torch says so in a RuntimeError, whose type needs an import."""
    return isinstance(error, MemoryError) or any(sign in str(error) for sign in _OUT_OF_MEMORY)
