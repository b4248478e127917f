"""Terms of the outer objective."""
