"""A small simulated world for the retrieval tests: its own seeds, none of which any shipped model has seen."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import xarray as xr

from services.retrieval.ease_grid import row_column
from services.retrieval.simulation.surface import Surface
from services.retrieval.simulation.training_world import DAY_MS, WorldPlan, make_specular_points, make_surface

PLAN = WorldPlan(seed=9001, latitude_deg=41.0, longitude_deg=-123.0, size_deg=1.5, first_day="2023-08-01", fires=5)
SPLIT_MS = PLAN.ignition_ms - 3 * DAY_MS


@lru_cache(maxsize=1)
def surface() -> Surface:
    return make_surface(PLAN)


@lru_cache(maxsize=4)
def points(start_ms: int, end_ms: int, stream: int = 0) -> geopandas.GeoDataFrame:
    return make_specular_points(PLAN, start_ms, end_ms, stream)


def write_surface(path: Path, plan: WorldPlan = PLAN) -> None:
    """The world's surface as the netCDF that a case bundle holds: burn times in seconds, NaN unburned."""
    world = make_surface(plan)
    reference = np.datetime64(plan.first_day, "ms")
    burned = ~np.isnat(world.burn_time)
    seconds = np.where(burned, (world.burn_time - reference).astype(np.float64) / 1e3, np.nan)
    flat = ("latitude", "longitude")
    dataset = xr.Dataset(
        {name: (flat, field) for name, field in world.static.items()},
        coords={
            "time": world.time.astype("datetime64[ns]"),
            "latitude": world.latitude_deg,
            "longitude": world.longitude_deg,
            "latitude_burn": world.burn_latitude_deg,
            "longitude_burn": world.burn_longitude_deg,
        },
    )
    dataset["soil_moisture"] = (("time", *flat), world.soil_moisture)
    dataset["burn_time"] = (("latitude_burn", "longitude_burn"), seconds)
    dataset["burn_time"].attrs = {"units": "s", "reference_time": f"{plan.first_day}T00:00:00Z"}
    dataset.to_netcdf(path)


def images_of(table: pd.DataFrame, count: int) -> pd.DataFrame:
    """An as_run table: the first satellite-seconds of a specular_points table, the last of them lost."""
    seconds = table[["satellite", "time"]].drop_duplicates().head(count).reset_index(drop=True)
    start = seconds["time"].dt.floor("s")
    status = ["downlinked"] * (count - 2) + ["collected", "lost"]
    down = [s + pd.Timedelta(hours=2) if k < count - 2 else pd.NaT for k, s in enumerate(start)]
    return pd.DataFrame(
        {
            "satellite": seconds["satellite"],
            "start": start,
            "end": start + pd.Timedelta(seconds=1),
            "image_id": np.arange(count, dtype=np.int32),
            "status": status,
            "downlinked_at": pd.to_datetime(pd.Series(down), utc=True),
            "station": "hawaii",
        }
    )


def write_smap(path: Path) -> None:
    """Soil moisture of another sensor: the nature's own with noise, every other day before the fires."""
    world = surface()
    latitude, longitude = np.meshgrid(world.latitude_deg, world.longitude_deg, indexing="ij")
    row, column = row_column(latitude.ravel(), longitude.ravel(), 9)
    rng = np.random.default_rng(4)
    parts = []
    for day in range(0, PLAN.days_before, 2):
        value = world.soil_moisture[day].ravel() + rng.normal(0.0, 0.02, row.size)
        table = pd.DataFrame({"row": row, "column": column, "soil_moisture": np.clip(value, 0.02, 0.6)})
        parts.append(table.assign(time=pd.Timestamp(world.time[day], tz="UTC") + pd.Timedelta(hours=12)))
    pd.concat(parts).groupby(["time", "row", "column"], as_index=False).mean().to_parquet(path)
