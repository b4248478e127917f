"""The mesh as binary glTF."""
