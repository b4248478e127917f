"""Surfaces to start from."""
