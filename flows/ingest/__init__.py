"""Live inputs: what providers publish, fetched with care, checked, kept, and never waited for without end."""
