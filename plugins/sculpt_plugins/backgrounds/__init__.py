"""What photographs show around the object."""
