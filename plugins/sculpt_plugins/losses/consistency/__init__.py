"""Photographs laid into each other through the surface."""
