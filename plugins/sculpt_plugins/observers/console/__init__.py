"""Tells what happens: a live display in a terminal, plain lines elsewhere."""
