"""The mesh as STL."""
