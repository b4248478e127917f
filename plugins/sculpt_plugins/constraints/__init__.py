"""What Gaussians on a face must keep to."""
