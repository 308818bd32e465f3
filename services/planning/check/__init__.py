"""The independent replay behind check-plan; nothing here imports the solver."""
