"""Fresh burn scars that the satellites saw: fuel that is gone, and comes back with regrowth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization.prefire import burn_evidence
from services.prioritization.prefire.danger_grid import METRES_PER_DEGREE, DangerGrid

Array = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class BurnScarEffect:
    """A fresh scar takes ``loss`` of the fuel where it is certain; regrowth gives it back with ``regrowth_days``."""

    loss: float = 0.9
    regrowth_days: float = 365.0


def burn_scar(
    tables: list[pd.DataFrame], grid: DangerGrid, time: pd.Timestamp, effect: BurnScarEffect, kind: Any = np.float64
) -> Array:
    """Share of the fuel (0..1) that fresh scars took from each grid cell (y, x); 0 where none is known.

    ``tables`` follow the burned_area contract. A look marks the cells within its footprint (half its length along the
    track, at least half a cell), in proportion to the area it covers of the cell and to how far its probability lies
    above the share that burns anyway: a look that says no more than that takes nothing, nor does one after ``time``.
    """
    scar = np.zeros(grid.shape, dtype=kind)
    for table in tables:
        burned = table[(burn_evidence.excess_probability(table) > 0) & (table["time"] <= time)]
        excess = burn_evidence.excess_probability(burned)
        points = burned.geometry.representative_point()
        for x, y, certain, row in zip(points.x, points.y, excess, burned.itertuples(), strict=True):
            height_m, width_m = grid.cell_m(y)
            radius_m = max(row.along_m / 2, row.across_m / 2, 0.505 * float(np.hypot(height_m, width_m)))
            rows, columns = grid.window(x, y, radius_m)
            longitude, latitude = grid.places(rows, columns)
            distance_m = METRES_PER_DEGREE * np.hypot((longitude - x) * np.cos(np.radians(y)), latitude - y)
            age_days = (time - row.time).total_seconds() / 86400
            covered = min(1.0, row.along_m * row.across_m / (height_m * width_m))
            lost = effect.loss * certain * covered * np.exp(-age_days / effect.regrowth_days)
            near, part = distance_m <= radius_m, scar[rows, columns]
            part[near] = 1 - (1 - part[near]) * (1 - lost)
    return np.minimum(scar, effect.loss)
