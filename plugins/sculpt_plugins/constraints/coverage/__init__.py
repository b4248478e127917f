"""Gaussians of a face spread over it."""
