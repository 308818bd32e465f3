"""Soil moisture from reflectivity: regression per cell, quantile models of raw-IF looks, skill, level-3 grids."""
