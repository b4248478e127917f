"""Scenes the project makes itself; ``--data demo`` or ``--data demo:NAME`` needs no file."""
