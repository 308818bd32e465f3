"""Orbits in: element sets and ephemerides of every format, read, checked and turned into Earth-fixed states."""
