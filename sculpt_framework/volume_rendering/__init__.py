"""Fields seen along rays: where to look, how much each stretch hides, and what a method of this kind needs besides."""
