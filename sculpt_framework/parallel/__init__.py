"""One run in several processes: torchrun."""
