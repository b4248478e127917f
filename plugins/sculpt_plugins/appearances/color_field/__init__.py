"""A colour field over position plus a small residual per Gaussian."""
