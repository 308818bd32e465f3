"""The WGS84 ellipsoid: geodetic coordinates, the normal as "up", and distances over its surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SEMI_MAJOR_M = 6378137.0  # NIMA TR8350.2 (WGS84)
FLATTENING = 1.0 / 298.257223563
SEMI_MINOR_M = SEMI_MAJOR_M * (1.0 - FLATTENING)
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
MEAN_RADIUS_M = (2.0 * SEMI_MAJOR_M + SEMI_MINOR_M) / 3.0


def up_vector(latitude_deg: Array, longitude_deg: Array) -> Array:
    """Unit normal of the ellipsoid (..., 3) at geodetic latitude and longitude."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    return np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )


def to_cartesian(latitude_deg: Array, longitude_deg: Array, height_m: Array | float = 0.0) -> Array:
    """Earth-fixed positions (..., 3) in metres of geodetic coordinates."""
    up = up_vector(np.asarray(latitude_deg), np.asarray(longitude_deg))
    prime_vertical_m = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * up[..., 2] ** 2)
    height = np.asarray(height_m)
    scale = np.stack([prime_vertical_m + height] * 2 + [prime_vertical_m * (1.0 - ECCENTRICITY_SQUARED) + height], -1)
    return np.asarray(up * scale)


def to_geodetic(position_m: Array) -> tuple[Array, Array, Array]:
    """Geodetic latitude, longitude (deg) and height (m) of Earth-fixed positions (..., 3).

    Bowring (1985) started from the reduced latitude and repeated twice: exact to 1e-9 m up to GNSS heights.
    """
    x, y, z = position_m[..., 0], position_m[..., 1], position_m[..., 2]
    from_axis = np.hypot(x, y)
    reduced = np.arctan2(z, (1.0 - FLATTENING) * from_axis)
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    for _ in range(3):
        latitude = np.arctan2(
            z + second * SEMI_MINOR_M * np.sin(reduced) ** 3,
            from_axis - ECCENTRICITY_SQUARED * SEMI_MAJOR_M * np.cos(reduced) ** 3,
        )
        reduced = np.arctan2((1.0 - FLATTENING) * np.sin(latitude), np.cos(latitude))
    sine = np.sin(latitude)
    height = from_axis * np.cos(latitude) + z * sine - SEMI_MAJOR_M * np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine**2)
    return np.degrees(latitude), np.degrees(np.arctan2(y, x)), height


def arc_from_chord_m(chord_m: Array) -> Array:
    """Length over the mean sphere of a straight line between two surface points (within 0.3 % of the geodesic)."""
    return np.asarray(2.0 * MEAN_RADIUS_M * np.arcsin(np.clip(chord_m / (2.0 * MEAN_RADIUS_M), 0.0, 1.0)))


def chord_from_arc_m(arc_m: float) -> float:
    """Straight line that belongs to a length over the mean sphere."""
    return float(2.0 * MEAN_RADIUS_M * np.sin(arc_m / (2.0 * MEAN_RADIUS_M)))
