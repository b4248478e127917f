"""FlexiCubes' L_dev."""
