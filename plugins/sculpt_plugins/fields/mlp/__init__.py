"""The paper's MLP."""
