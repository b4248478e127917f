"""Recognises what ``--data`` names and hands it to the dataset that reads it."""
