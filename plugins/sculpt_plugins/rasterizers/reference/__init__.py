"""Plain torch: the twin every other backend is compared with."""
