"""Files that leave a run: meshes and Gaussians in the formats other programs open."""
