"""K Gaussians per face at learnable barycentric coordinates (the paper's)."""
