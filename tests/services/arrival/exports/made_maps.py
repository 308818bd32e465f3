"""Arrival maps with a known shape, for what is made of them: a fire that spreads evenly from the middle."""

from __future__ import annotations

import numpy as np
import pandas as pd

from services.arrival.extent import Evidence
from services.arrival.grid import FireGrid, make_grid
from services.arrival.inference import ArrivalMap

REFERENCE = pd.Timestamp("2022-06-01T18:00Z")


def round_fire(
    longitude_deg: float = -106.0,
    latitude_deg: float = 33.5,
    cell_m: float = 250.0,
    speed_km_h: float = 0.25,
    end_h: float = 24.0,
) -> ArrivalMap:
    """A disc that grows at one speed until `end_h`; the arrival is the distance from the middle over the speed."""
    grid: FireGrid = make_grid(np.array([longitude_deg]), np.array([latitude_deg]), cell_m, 10.0)
    x, y = grid.cell_centres_km()
    hours = np.hypot(x, y) / speed_km_h
    arrival = np.where(hours <= end_h, hours, np.nan)
    burned = np.isfinite(arrival)
    information = np.where(burned, 2, np.where(x > 8.0, 0, 1)).astype(np.uint8)
    latest = np.where(information == 0, np.nan, end_h - 3.0)
    nothing = np.zeros(grid.shape)
    evidence = Evidence(information, latest, nothing, burned, nothing)
    blank = np.where(burned, 0.0, np.nan)
    return ArrivalMap(
        grid, evidence, arrival, blank + 2.0, arrival - 3.0, arrival + 3.0, burned.astype(float), (), 0, 0
    )
