"""The mesh as PLY."""
