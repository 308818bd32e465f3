"""The ``smokeglint`` command: what an operator does from a shell."""
