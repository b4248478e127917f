"""Scenes the project makes itself: analytic objects, rendered by sphere tracing, with exact ground truth."""
