"""Sparse reconstructions of COLMAP, binary or text, and the photographs they were made from."""
