"""A multi-resolution hash grid with a small decoder: the fast field."""
