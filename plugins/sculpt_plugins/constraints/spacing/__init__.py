"""Gaussians of a face apart from each other."""
