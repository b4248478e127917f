"""Whichever backend suits the device best."""
