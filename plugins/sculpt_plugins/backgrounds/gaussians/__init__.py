"""Free Gaussians behind the object."""
