"""Gradient norm one around the surface."""
