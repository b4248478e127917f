"""Gaussian opacity fields (Yu et al. 2024)."""
