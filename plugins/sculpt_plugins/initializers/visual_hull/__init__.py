"""What the silhouettes alone say."""
