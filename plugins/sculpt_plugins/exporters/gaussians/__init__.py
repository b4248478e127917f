"""The Gaussians as 3DGS writes them."""
