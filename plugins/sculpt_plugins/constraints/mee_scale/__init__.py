"""Gaussians inside their face's ellipse."""
