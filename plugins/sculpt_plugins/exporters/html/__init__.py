"""A page that plays how the surface came to be."""
