"""GSDF (Yu et al. 2024)."""
