"""Few sign changes: against floaters and inner bubbles."""
