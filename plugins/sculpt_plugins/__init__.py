"""Everything one can swap; one folder per plug-in."""
