"""What rays through the pixels of all views say."""
