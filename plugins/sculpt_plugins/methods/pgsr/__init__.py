"""PGSR (Chen et al. 2024)."""
