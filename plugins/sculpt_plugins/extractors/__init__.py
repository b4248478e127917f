"""Plug-ins of slot ``extractor``."""
