"""Relightable 3D Gaussian (Gao et al. 2024)."""
