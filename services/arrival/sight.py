"""Who looked where and when: the latest clear look of every cell, and the latest pass that cloud or water hid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.arrival.extent import FIRE_SEEN, NOT_SEEN, paint
from services.arrival.grid import FireGrid
from services.arrival.inference import ArrivalMap
from services.arrival.looks import looks_from_detections

NO_PASS, HIDDEN, CLEAR, BURNING = 0, 1, 2, 3
MEANINGS = ("no_pass", "hidden_by_cloud_or_water", "no_fire_seen", "fire_seen")
CORNER = float(np.sqrt(np.pi / 2.0))
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


@dataclass(frozen=True)
class Passes:
    """Hours (rows, columns) since the reference time of the latest no-fire look, and of the latest look that cloud,
    water or glint hid; NaN where there was none. Of all rows, also those that inference thins out."""

    no_fire_h: Floats
    hidden_h: Floats


def _latest(frame: gpd.GeoDataFrame, grid: FireGrid, reference: pd.Timestamp, end_h: float) -> Floats:
    nothing = np.full(grid.shape, np.nan)
    if len(frame) == 0:
        return nothing
    x, y = grid.local_km(frame.geometry.x.to_numpy(float), frame.geometry.y.to_numpy(float))
    rows, columns = grid.shape
    half = grid.cell_m / 2e3
    hours = (pd.to_datetime(frame["time"], utc=True) - reference).dt.total_seconds().to_numpy(float) / 3600.0
    inside = (np.abs(x) <= columns * half) & (np.abs(y) <= rows * half) & (hours <= end_h)
    if not inside.any():
        return nothing
    looks = looks_from_detections(frame[inside], grid, reference)
    # A disc of a pixel's area leaves out its corners, and cells finer than the pixel would fall between two of them.
    return paint(grid, replace(looks, radius_km=CORNER * looks.radius_km), "last")


def paint_passes(
    detections: gpd.GeoDataFrame, obscured: gpd.GeoDataFrame, grid: FireGrid, reference: pd.Timestamp, end_h: float
) -> Passes:
    """When the cells of a grid were last looked at without fire, and last passed over without a view."""
    no_fire = detections[~detections["fire"].to_numpy(bool)]
    return Passes(_latest(no_fire, grid, reference, end_h), _latest(obscured, grid, reference, end_h))


def sight_of(arrival: ArrivalMap, passes: Passes | None = None) -> Sight:
    """What was known of every cell of a fire's map by the end of its period."""
    evidence = arrival.evidence
    clear_h = np.where(evidence.information == NOT_SEEN, np.nan, evidence.latest_h)
    hidden_h = np.full(arrival.grid.shape, np.nan)
    if passes is not None:
        clear_h, hidden_h = np.fmax(clear_h, passes.no_fire_h), passes.hidden_h
    state = np.where(np.isfinite(hidden_h), HIDDEN, NO_PASS).astype(np.uint8)
    state[np.isfinite(clear_h)] = CLEAR
    state[evidence.information == FIRE_SEEN] = BURNING
    return Sight(state, clear_h, hidden_h)
