"""How far the fit alone may be off: an uncertainty that was calibrated on the tuning seeds of the synthetic fires."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.arrival.looks import Ignition, Looks

# Variance of the error (h^2) on synthetic tuning fires: a constant, the spread of the members (too small by itself),
# half a pixel times the pace of the front, the distance to the nearest evidence, and the pass interval as a uniform
# draw (/12).
SD_CONSTANT_H, SPREAD_FACTOR, PACE_KM, DISTANCE_H_PER_KM = 1.1, 1.5, 0.4, 2.8
Z95 = 1.645
Floats = NDArray[np.float64]


def error_variance(
    looks: Looks, ignition: Ignition, arrival_h: Floats, spread_h: Floats, distance_km: Floats, cell_km: float
) -> Floats:
    """Variance of the error (rows, columns), h^2, of arrivals whose ensemble members have the standard deviation
    `spread_h`, `distance_km` from the nearest evidence."""
    return np.asarray(
        SD_CONSTANT_H**2
        + (SPREAD_FACTOR * spread_h) ** 2
        + _pass_interval(looks, ignition, arrival_h) ** 2 / 12.0
        + (PACE_KM * _pace(arrival_h, cell_km)) ** 2
        + (DISTANCE_H_PER_KM * distance_km) ** 2
    )


def _pass_interval(looks: Looks, ignition: Ignition, arrival_h: Floats) -> Floats:
    """Hours between the passes (or ignition) that bracket each arrival (n,)."""
    passes = np.unique(np.append(np.round(looks.time_h, 2), ignition.time_h))
    after = np.clip(np.searchsorted(passes, arrival_h), 1, max(passes.size - 1, 1))
    if passes.size == 1:
        return np.full(arrival_h.shape, 24.0)
    return passes[after] - passes[after - 1]


def _pace(arrival_h: Floats, cell_km: float) -> Floats:
    """Hours that the front takes for a kilometre (rows, columns)."""
    if min(arrival_h.shape) < 2:
        return np.zeros_like(arrival_h)
    d_row, d_column = np.gradient(arrival_h, cell_km)
    return np.clip(np.hypot(d_row, d_column), 0.0, 10.0)


def late_share(arrival_h: Floats, sd_h: Floats, end_h: float) -> Floats:
    """Roughly the probability that the fire comes only after `end_h`, where arrival is near the end."""
    return np.clip(0.5 + (arrival_h - end_h) / (2 * Z95 * sd_h), 0.0, 0.5)
