"""Who looked where and when: the latest clear look of every cell, and the latest pass that cloud or water hid."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.arrival.extent import FIRE_SEEN, NO_FIRE_SEEN, NOT_SEEN, paint
from services.arrival.fires import FireCase
from services.arrival.inference import ArrivalMap
from services.arrival.looks import Looks, looks_from_detections

NO_PASS, HIDDEN, CLEAR, BURNING = 0, 1, 2, 3
MEANINGS = ("no_pass", "hidden_by_cloud_or_water", "no_fire_seen", "fire_seen")
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sight:
    """Per cell (rows, columns): `state` NO_PASS | HIDDEN | CLEAR | BURNING by the end of the period, hours of the
    latest clear look and of the latest hidden one since the reference time (NaN: none)."""

    state: NDArray[np.uint8]
    clear_h: Floats
    hidden_h: Floats

    def age_h(self, end_h: float) -> Floats:
        """Age of the latest clear look at the end, hours; NaN where there was none."""
        return end_h - self.clear_h


def hidden_looks(obscured: gpd.GeoDataFrame, case: FireCase) -> Looks | None:
    """Pixels that a pass covered and could not judge, on the fire's grid; None where there are none."""
    if len(obscured) == 0:
        return None
    x, y = case.grid.local_km(obscured.geometry.x.to_numpy(float), obscured.geometry.y.to_numpy(float))
    rows, columns = case.grid.shape
    half = case.grid.cell_m / 2e3
    hours = (pd.to_datetime(obscured["time"], utc=True) - case.reference).dt.total_seconds().to_numpy(float) / 3600.0
    inside = (np.abs(x) <= columns * half) & (np.abs(y) <= rows * half) & (hours <= case.end_h)
    return looks_from_detections(obscured[inside], case.grid, case.reference) if inside.any() else None


def sight_of(case: FireCase, arrival: ArrivalMap, obscured: gpd.GeoDataFrame | None = None) -> Sight:
    """What was known of every cell of a fire's map by the end of its period."""
    evidence = arrival.evidence
    hidden = hidden_looks(obscured, case) if obscured is not None else None
    hidden_h = paint(case.grid, hidden, "last") if hidden is not None else np.full(case.grid.shape, np.nan)
    clear_h = np.where(evidence.information == NOT_SEEN, np.nan, evidence.latest_h)
    state = np.full(case.grid.shape, NO_PASS, np.uint8)
    state[np.isfinite(hidden_h)] = HIDDEN
    state[evidence.information == NO_FIRE_SEEN] = CLEAR
    state[evidence.information == FIRE_SEEN] = BURNING
    return Sight(state, clear_h, hidden_h)
