"""The mesh as OBJ."""
