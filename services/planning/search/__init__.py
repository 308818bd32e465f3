"""Counted, seeded search over image sets on both cores, guided by the relaxation."""
