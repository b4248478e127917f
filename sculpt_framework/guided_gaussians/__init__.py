"""Gaussians beside a signed distance field: drawn both ways, and learned together."""
