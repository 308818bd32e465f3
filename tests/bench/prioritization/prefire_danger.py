"""Time of pre-fire danger: a small grid as in a case of the loop, and a day of the whole country at 1 km."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from services.prioritization.prefire import conditions, danger, danger_run, fuels, vegetation_2001
from tests.bench.prioritization import conus_day
from tests.bench.prioritization.active_fires import START, made_up_weather

Metric = tuple[str, float, str, float | None]


def time_of_a_danger_grid() -> Iterator[Metric]:
    """60 x 60 cells, eight lead days, soil moisture none; the second run."""
    air = made_up_weather(30, 192)
    axis = np.linspace(0, 3, 60)
    flat = np.ones((60, 60))
    water = np.zeros((60, 60), dtype=bool)
    water[0, 0] = True
    fields = {"ndvi": 0.4 * flat, "ndvi_min": 0.2 * flat, "ndvi_max": 0.7 * flat}
    given = fuels.fuels_from_dataset(vegetation_2001.with_fuels(fields, 32 + axis, -109 + axis, water))
    seconds = 0.0
    for _ in range(2):
        began = time.perf_counter()
        daily = conditions.daily_conditions(air, None, START)
        seen = danger.seen_land(given.grid, [], [], START, danger.DangerEffects())
        rated = danger_run.rate(given, daily, seen, START)
        seconds = time.perf_counter() - began
        assert int(rated.tally.known.sum()) == 8 * 3599
    yield "danger_60x60_8_days_s", seconds, "s", 2.0


def conus_day_at_1_km(vegetation: Path | None) -> Iterator[Metric]:
    """WFPI and WFPI-x of a day on the whole USGS grid, from files to COGs, in a fresh process."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        conus_day.make_inputs(folder, vegetation)
        found = conus_day.measured(folder)
    yield "wfpi_conus_day_s", found["seconds"], "s", 20.0
    yield "wfpi_peak_gb", found["peak_gb"], "GB", 4.0
    yield "wfpi_conus_share_changed", found["share_changed"], "1", None
