"""Skill of the large-fire model on unseen real fires, and the time of 64 ratings."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
from shapely.geometry import Point

from services.prioritization import sources, weather
from services.prioritization.large_fire import evaluation, features, rating, training, validation
from services.prioritization.large_fire import model as large_fire_model
from tests.bench.prioritization import fuel_moisture_trial

LABEL = "uncontrolled_within_100_ha"
FIRST_SEASON = "2013-14"
START = pd.Timestamp("2022-06-10T18:00:00Z")
Metric = tuple[str, float, str, float | None]


def _tested(table: pd.DataFrame, schema: features.Schema) -> dict[str, object]:
    fires = validation.checked(table, LABEL, "season", schema)
    folds = [fold for fold in validation.folds(fires, schema) if fold.name >= FIRST_SEASON]
    return evaluation.evaluate(fires, folds, schema, resamples=2)


def skill_of_real_fires(folder: Path) -> Iterator[Metric]:
    """Rolling origin from 2013-14 on, seasons to 2017-18; then US fires, one region left out at a time."""
    table = sources.fire_table(folder / "large_fire" / "victoria_2008_2018.csv.gz")
    bars = {"auc": 0.86, "mcc": 0.32, "brier_skill": 0.12, "calibration_slope": "0.8-1.2"}
    for schema, suffix in (("full", ""), ("loop", "_loop")):
        result = _tested(table, schema)  # type: ignore[arg-type]
        for name, bar in bars.items():
            yield name + suffix, result[name], "1", None if suffix else bar  # type: ignore[misc]
        if not suffix:
            best = result["natural"][result["best_index_by_mcc"]]["mcc"]  # type: ignore[index]
            yield "mcc_best_index", best, "1", None
            yield "mcc_over_best_index", result["mcc"] / best, "1", 1.4  # type: ignore[operator]
            yield "calibration_error", result["calibration_error"], "1", None  # type: ignore[misc]
            yield "top_decile_forecast", result["top_decile"]["forecast"], "1", None  # type: ignore[index]
            yield "top_decile_observed", result["top_decile"]["observed"], "1", None  # type: ignore[index]
            yield "mcc_one_to_two", result["one to two"]["model"]["mcc"], "1", None  # type: ignore[index]
    us = sources.fire_table(folder / "large_fire" / "us_gridmet_ics209.csv")
    arguments = {"design": "leave-one-out", "resamples": 2}
    skill = training.train_and_test(us, "large_1000ac", "region", "us", **arguments).skill  # type: ignore[arg-type]
    yield "us_auc", skill["auc"], "1", None
    yield "us_mcc", skill["mcc"], "1", None
    yield "us_brier_skill", skill["brier_skill"], "1", None
    yield "us_mcc_best_index", skill["natural"][skill["best_index_by_mcc"]]["mcc"], "1", None


def ablation_of_real_fires(folder: Path) -> Iterator[Metric]:
    """AUC and MCC with index columns only, + weather, + moisture, + land, for trees, regression and their mean."""
    table = sources.fire_table(folder / "large_fire" / "victoria_2008_2018.csv.gz")
    fires = validation.checked(table, LABEL, "season", "full")

    def folds(groups: tuple[features.Group, ...]) -> list[validation.Fold]:
        made = validation.folds(fires, "full", groups=groups)
        return [fold for fold in made if fold.name >= FIRST_SEASON]

    for row in evaluation.ablation(fires, folds):
        name = f"{row['columns'].replace(' + ', '_')}_{row['learner']}"
        yield f"auc_{name}", row["auc"], "1", None
        yield f"mcc_{name}", row["mcc"], "1", None


def fuel_moisture_of_five_years(folder: Path) -> Iterator[Metric]:
    """The filter against the model alone under five years of a real station's weather; truth and sensor synthetic."""
    station = fuel_moisture_trial.read_station(folder / "weather" / "raws_260402_hourly_2012_2016.csv.gz")
    yield from fuel_moisture_trial.metrics(fuel_moisture_trial.run(station))


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


def time_of_64_ratings() -> Iterator[Metric]:
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
    yield "rate_64_fires_s", seconds, "s", 1.0
