"""A pyramid of dense grids: the discrete SDF of the paper's ablation."""
