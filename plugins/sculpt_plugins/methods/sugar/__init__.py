"""SuGaR (Guedon and Lepetit 2024)."""
