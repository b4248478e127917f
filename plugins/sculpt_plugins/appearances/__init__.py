"""Colours of Gaussians."""
