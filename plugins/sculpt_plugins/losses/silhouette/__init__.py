"""Coverage against the mask."""
