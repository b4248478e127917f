"""Depths and normals."""
