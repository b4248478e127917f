"""How a command ends: 0 done, 2 the user can mend it (one line on stderr), 130 interrupted, else a fault of ours."""

import os
import sys
from collections.abc import Callable

from sculpt_framework.errors import SculptError


def run(main: Callable[[], None]) -> None:
    """Run a command. A SculptError becomes one line on stderr and exit code 2; any other error keeps its traceback."""
    try:
        main()
    except SculptError as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # Whoever reads our output has seen enough, as in ``sculpt-train METHOD --help | head``. Python flushes stdout
        # once more at exit, which must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
