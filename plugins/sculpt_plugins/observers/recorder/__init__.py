"""Keeps what happened: events.jsonl, curve.csv, metrics.json in the run directory."""
