"""Weather that cannot be: refused by name, or taken out and told; never a fire that looks safe for it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from services.prioritization import weather
from shared.contracts import schema, tables
from shared.errors import DomainError


def _rate(room, make, time, grid, name="weather.nc", **more):
    incidents = room.table("incidents.parquet", make["incidents"](), "INCIDENTS")
    out = room.run("rate-active-fires", incidents=incidents, weather=room.grid(name, grid), time=time, **more)
    ratings = schema.read_table(room.path(out["ratings"]), tables.RATINGS).set_index("incident_id")
    return ratings, json.loads(room.path(out["report"]).read_text())


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("relative_humidity_pct", lambda v: v / 100),
        ("temperature_c", lambda v: v * 1.8 + 32 + 20),
        ("temperature_c", lambda v: v.where(v["time"].dt.dayofyear != 162, 300.0)),
        ("wind_speed_m_s", lambda v: v * 0 - 9999.0),
        ("rain_mm", lambda v: v + 9e36),
        ("temperature_c", lambda v: v.assign_attrs(units="K")),
        ("wind_speed_m_s", lambda v: v.assign_attrs(units="km/h")),
        ("temperature_c", lambda v: v * np.nan),
    ],
)
def test_wrong_units_are_refused_by_name(room, make, time, name, change):
    grid = make["weather"](hours=48)
    grid[name] = change(grid[name])
    with pytest.raises(DomainError) as caught:
        _rate(room, make, time, grid)
    assert caught.value.field == name


def test_stated_units_that_agree_are_welcome(make):
    grid = make["weather"](hours=24)
    for name, units in weather.UNITS.items():
        grid[name].attrs["units"] = units[-1]
    assert weather.weather_from_dataset(grid).flagged == dict.fromkeys(weather.UNITS, 0)


def test_a_freak_cell_is_taken_out_counted_and_imputed(room, make, time):
    grid = make["weather"](hours=48)
    cell = grid["temperature_c"].sel(longitude=-108.2, latitude=33.2, method="nearest")
    where = {"latitude": float(cell["latitude"]), "longitude": float(cell["longitude"])}
    sound, _ = _rate(room, make, time, grid, "sound.nc")
    grid["temperature_c"].loc[where] = 300.0
    ratings, report = _rate(room, make, time, grid)
    assert report["weather_values_taken_out"]["temperature_c"] == grid.sizes["time"]
    assert "temperature_c" in ratings.loc["A", "imputed"] and ratings.loc["B", "imputed"] == sound.loc["B", "imputed"]
    assert ratings.loc["A", "probability"] > 0.01
    assert ratings.loc["B", "probability"] == sound.loc["B", "probability"]


def test_a_nan_block_is_imputed_and_flagged_not_safe(room, make, time):
    grid = make["weather"](hours=48)
    grid["wind_speed_m_s"] = grid["wind_speed_m_s"].where(grid["longitude"] > -107.6)
    ratings, report = _rate(room, make, time, grid)
    assert "wind_speed_m_s" in report["imputed"]["A"] and "wind_speed_m_s" not in report["imputed"].get("B", "")
    assert ratings.loc["A", "probability"] > 0.01


def test_percentile_names_the_fires_it_is_among(room, make, time):
    fuels = make["fuels"]()
    fuels["elevation_m"] = fuels["kbdi"] * 0 + 300.0
    ratings, _ = _rate(room, make, time, make["weather"](hours=48), fuels=room.grid("fuels.nc", fuels))
    assert ratings.loc["A", "compared_with"].endswith("past fires: dry hills")
    assert 0 <= ratings.loc["A", "percentile"] <= 100
    without, _ = _rate(room, make, time, make["weather"](hours=48), "again.nc")
    assert without.loc["A", "compared_with"].endswith("past fires: all")
