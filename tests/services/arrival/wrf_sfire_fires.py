"""Coupled atmosphere-fire simulations (WRF-SFIRE) as truth, seen by simulated overpasses through cloud."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat

from tests.services.arrival.synthetic_fires import Place, SyntheticFire, observed

CELL_KM = 0.03
UNBURNED_S = 172_800.0
EVERY = 2  # 60 m is fine enough for pixels of 375 m


def arrival_maps(data: Path) -> list[np.ndarray]:
    """The fire-arrival maps, hours (n, n), NaN unburned, in the order of their names."""
    maps = []
    for path in sorted((data / "fire_arrival" / "wrf_sfire").glob("*.mat")):
        seconds = np.asarray(loadmat(path)["fire_arrival_time"], float)[::EVERY, ::EVERY]
        maps.append(np.where(seconds < UNBURNED_S, seconds / 3600.0, np.nan))
    return maps


def wrf_sfire_fire(arrival_h: np.ndarray, seed: int, observations: int | None = None) -> SyntheticFire:
    """Two days of overpasses, 4-8 a day, over one map; the seed decides passes, cloud, detection and residence."""
    rng = np.random.default_rng(seed)
    start = np.unravel_index(int(np.nanargmin(arrival_h)), arrival_h.shape)
    place = Place(13, (400_000.0, 3_700_000.0))
    cell_km = CELL_KM * EVERY
    return observed(
        seed, rng, arrival_h, cell_km, (int(start[0]), int(start[1])), 2, observations, 0, None, place, 24.0
    )
