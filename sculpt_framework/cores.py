"""How many cores there are for this process."""

import os
import sys


def usable_cores() -> int:
    """Those it may run on; all of the machine where the system does not say."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
