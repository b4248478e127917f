"""Small FlexiCubes weights."""
