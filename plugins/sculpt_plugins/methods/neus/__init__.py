"""NeuS (Wang et al. 2021)."""
