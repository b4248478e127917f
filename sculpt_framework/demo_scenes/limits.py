"""How large a demo scene may be. Free of torch, for ``--help``."""

from sculpt_framework.ranges import between

TRAIN_VIEWS = between(1, 10_000)
TEST_VIEWS = between(0, 10_000)
RESOLUTION = between(16, 4096)
"""Side of the square images, in pixels."""
