"""Gaussians on faces."""
