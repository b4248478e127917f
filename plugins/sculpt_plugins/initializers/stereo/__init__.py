"""What the silhouettes and the agreement of colours say."""
