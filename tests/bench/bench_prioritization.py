"""Skill of the large-fire model on unseen seasons of real fires, and the time of a rating and of a danger grid.

``python -m tests.bench.bench_prioritization`` prints one JSON object a line. Skill needs SMOKEGLINT_DATA (the
Victorian fires); without it only the timings are printed. ``auc`` … are of the model with land columns; those ending
in ``_loop`` of the shipped one, which has only what every case of the loop carries.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
from shapely.geometry import Point

from services.prioritization import features, large_fire_model, large_fire_skill, rating, weather
from services.prioritization.prefire import danger
from services.prioritization.prefire.fire_potential import MASK_CODES

LABEL = "uncontrolled_within_100_ha"
START = pd.Timestamp("2022-06-10T18:00:00Z")


def report(name: str, value: float, unit: str, bar: float | None) -> None:
    """One metric as one line."""
    print(json.dumps({"name": name, "value": round(float(value), 4), "unit": unit, "bar": bar}), flush=True)


def skill_of_real_fires(folder: Path) -> None:
    """Rolling origin from 2013-14 on, seasons to 2017-18."""
    table = pd.read_csv(folder / "large_fire" / "victoria_2008_2018.csv.gz", low_memory=False)
    fires = features.from_victoria(table)
    bars = {"auc": 0.86, "mcc": 0.32, "brier_skill": 0.12, "calibration_slope": 1.0}
    for schema, suffix in (("full", ""), ("loop", "_loop")):
        result = large_fire_skill.evaluate(fires, LABEL, "season", schema, "2013-14")
        for name, bar in bars.items():
            report(name + suffix, result[name], "1", None if suffix else bar)
        if not suffix:
            report("mcc_best_index", max(values["mcc"] for values in result["indices"].values()), "1", None)


def made_up_weather(cells: int, hours: int) -> weather.WeatherGrid:
    """Random but smooth hourly weather on a square grid from START."""
    rng = np.random.default_rng(0)
    shape = (hours, cells, cells)
    axis = np.linspace(0, 3, cells)
    start = np.datetime64(START.tz_localize(None), "ns")
    times = start + np.arange(1, hours + 1) * np.timedelta64(1, "h")
    fields = {
        "temperature_c": 25 + 8 * np.sin(np.arange(hours) * np.pi / 12)[:, None, None] + rng.normal(0, 1, shape),
        "relative_humidity_pct": np.clip(rng.normal(25, 8, shape), 3, 100),
        "wind_speed_m_s": rng.gamma(3, 2, shape),
        "rain_mm": np.zeros(shape),
    }
    return weather.WeatherGrid(times, 32 + axis, -109 + axis, fields)


def time_of_64_ratings() -> None:
    """64 fires from loaded weather to ratings with intervals and drivers, model loading included; the second run."""
    grid = made_up_weather(30, 192)
    rng = np.random.default_rng(1)
    places = [Point(x, y) for x, y in zip(rng.uniform(-109, -106, 64), rng.uniform(32, 35, 64), strict=True)]
    fires = geopandas.GeoDataFrame({"incident_id": [f"F{i}" for i in range(64)]}, geometry=places, crs="EPSG:4326")
    seconds = 0.0
    for _ in range(2):
        began = time.perf_counter()
        model = large_fire_model.load(large_fire_model.shipped_path())
        conditions = rating.burning_conditions(
            fires,
            lambda x, y: weather.series_at(grid, x, y),
            START,
            lambda x, y: 100.0,
            lambda x, y, hour: float("nan"),
            model.calibration.median,
        )
        rated = rating.rate(fires, conditions, model, START)
        seconds = time.perf_counter() - began
        assert len(rated) == 64 and rated["probability"].between(0, 1).all()
    report("rate_64_fires_s", seconds, "s", 1.0)


def time_of_a_danger_grid() -> None:
    """60 x 60 cells, eight lead days, soil moisture none; the second run."""
    grid = made_up_weather(30, 192)
    cells = 60
    axis = np.linspace(0, 3, cells)
    flat = np.ones((cells, cells))
    mask = np.zeros((cells, cells), dtype=np.uint8)
    mask[0, 0] = max(MASK_CODES)
    fuels = danger.Fuels(
        32 + axis, -109 + axis, 0.4 * flat, 0.7 * flat, flat, flat, 25 * flat, mask, flat * 0.05, flat * 0.3
    )
    seconds = 0.0
    for _ in range(2):
        began = time.perf_counter()
        conditions = danger.conditions_on_fuels(grid, None, START, fuels)
        seen = danger.seen_land(fuels, [], [], START, danger.DangerEffects())
        result = danger.danger(fuels, conditions, seen, START)
        seconds = time.perf_counter() - began
        assert int(np.isfinite(result["wfpi"].to_numpy()).sum()) == 8 * (cells * cells - 1)
    report("danger_60x60_8_days_s", seconds, "s", 2.0)


if __name__ == "__main__":
    if os.environ.get("SMOKEGLINT_DATA"):
        skill_of_real_fires(Path(os.environ["SMOKEGLINT_DATA"]))
    time_of_64_ratings()
    time_of_a_danger_grid()
