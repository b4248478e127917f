"""From image files with cameras to the views and the box of a scene, whatever layout on disk described them."""
