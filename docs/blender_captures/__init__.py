"""Rendered captures that are as hard as photographs, with the truth (docs/make_captures.py)."""
