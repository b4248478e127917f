"""Datasets: where views come from."""
