"""Prioritization: how dangerous is each fire and each place, and what is looking at it worth."""
