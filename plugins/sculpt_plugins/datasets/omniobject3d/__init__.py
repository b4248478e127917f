"""OmniObject3D as it is released: renders of scanned objects, and the scans (its own page: omniobject3d.github.io)."""
