"""Gaussian Sculpting: posed images of one object in, a watertight mesh out."""

import os

# Spinning OpenMP threads of torch and numba fight for the same cores: a render after a matmul was 4.5 times slower.
# The runtime reads this once, when the first of the two libraries is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
