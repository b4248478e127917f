"""The method of the paper: a signed distance sculpted through Gaussians on its surface, in a bi-level loop."""
