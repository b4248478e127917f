"""Stiff and extreme cases with a figure each: what ``sculpt-stress`` runs."""
