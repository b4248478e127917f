"""How a command ends: 0 done; 2 the user can mend it, 1 training failed, each with one line on stderr; 130 interrupted.

A fault of ours keeps its traceback.
"""

import os
import sys
from collections.abc import Callable

from sculpt_framework.errors import SculptError, TrainingFailed


def run(main: Callable[[], None]) -> None:
    """Run a command. SculptError and TrainingFailed become one line on stderr; any other error keeps its traceback."""
    try:
        main()
    except (SculptError, TrainingFailed) as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        sys.exit(2 if isinstance(error, SculptError) else 1)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # Whoever reads our output has seen enough, as in ``sculpt-train METHOD --help | head``. Python flushes stdout
        # once more at exit, which must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
