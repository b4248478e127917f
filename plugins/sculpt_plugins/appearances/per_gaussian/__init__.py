"""Spherical harmonics on every Gaussian (the paper's)."""
