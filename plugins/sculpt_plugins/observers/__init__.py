"""Who hears what training does; one folder per plug-in."""
