"""Backends of the rasteriser; each folder is one, and all do the arithmetic of `reference`."""
