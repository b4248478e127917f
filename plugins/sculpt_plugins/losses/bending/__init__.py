"""Bending between faces."""
