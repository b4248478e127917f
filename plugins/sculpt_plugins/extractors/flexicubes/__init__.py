"""Dual surface extraction with learnable weights (Shen et al. 2023), on a narrow band."""
