"""Specular points: the reflecting ellipsoid, antennas and tracks."""
