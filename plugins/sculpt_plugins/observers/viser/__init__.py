"""The surface being sculpted, in a browser."""
