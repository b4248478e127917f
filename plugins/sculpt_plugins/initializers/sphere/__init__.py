"""The paper's start."""
