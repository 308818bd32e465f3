"""Pre-fire danger: the WFPI family on a grid, with and without what the satellites saw of the land."""
