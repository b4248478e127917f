"""3DGSR (Lyu et al. 2024)."""
