"""The mesh as 3MF."""
