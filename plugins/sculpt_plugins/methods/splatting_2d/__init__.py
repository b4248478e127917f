"""2D Gaussian splatting (Huang et al. 2024)."""
