"""The scene plan: what a run leaves out because this scene's data do not ask for it (docs/background/plan.md)."""
