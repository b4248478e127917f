"""Gaussians away from edges."""
