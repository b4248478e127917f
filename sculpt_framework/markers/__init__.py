"""Printed markers: boards to print, their detection in photographs, the scale, ground and cameras that follow."""
