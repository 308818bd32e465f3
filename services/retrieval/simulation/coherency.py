"""The ratio of power at the peak to power around it, as level-1 gives it beside a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.retrieval.simulation.ambiguity import MapGrid

CHUNK = 1024
NOISE_DEVIATIONS = 2.0  # bins below so many deviations of the noise are eliminated
CENTRE_CHIPS, CENTRE_HZ = 0.26, 500.0  # a nominal bin to either side of the peak


def coherency_ratio(maps_w: NDArray[np.float32], grid: MapGrid) -> NDArray[np.float64]:
    """Power of the bins about the peak over that of the bins farther off, noise bins eliminated, (n,).

    Maps (n, delay, Doppler). After Al-Khaldi et al. 2021 and ``coherency_ratio`` of the data dictionary (UM 148-0346).
    """
    near_rows = round(CENTRE_CHIPS / grid.delay_resolution_chips)
    near_columns = round(CENTRE_HZ / grid.doppler_resolution_hz)
    rows, columns = np.arange(grid.delays), np.arange(grid.dopplers)
    ratio = np.empty(len(maps_w))
    for start in range(0, len(maps_w), CHUNK):
        part = maps_w[start : start + CHUNK]
        peak = part.reshape(len(part), -1).argmax(axis=1)
        floor = NOISE_DEVIATIONS * part[:, : grid.delays // 4].std(axis=(1, 2), keepdims=True)
        power = np.where(part > floor, part, 0.0)
        inside = (np.abs(rows - peak[:, None] // grid.dopplers) <= near_rows)[:, :, None] & (
            np.abs(columns - peak[:, None] % grid.dopplers) <= near_columns
        )[:, None, :]
        centre = (power * inside).sum(axis=(1, 2), dtype=np.float64)
        around = power.sum(axis=(1, 2), dtype=np.float64) - centre
        ratio[start : start + CHUNK] = centre / np.maximum(around, 1e-3 * np.maximum(centre, 1e-30))
    return ratio
