"""The mesh as it turns."""
