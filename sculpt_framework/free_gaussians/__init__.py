"""Gaussians bound to nothing: what they learn, how they multiply, and a mesh of the depths they show."""
