"""What the looks around a place say about when it burned, beyond the fitted field: learned from simulated fires."""
