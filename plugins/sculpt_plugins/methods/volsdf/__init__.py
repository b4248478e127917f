"""VolSDF (Yariv et al. 2021)."""
