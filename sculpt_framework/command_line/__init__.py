"""From the words of a ``sculpt-train`` command line to a config. Free of torch."""
