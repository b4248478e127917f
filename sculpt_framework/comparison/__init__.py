"""Runs beside each other: what run directories hold, what it says over seeds and scenes, and pages that show it."""
