"""A day of the whole conterminous United States at 1 km: makes the inputs, then rates it in a process of its own.

NDVI is real where SMOKEGLINT_DATA is set (MODIS, September 2001 between that year's extremes, sampled to 1 km), else
made up; weather, soil moisture and burned area are always made up: a marked, synthetic case of full size. The time and
memory are of the whole process ``rate-prefire-danger`` for one lead day: reading, WFPI and WFPI-x (and the WLFP and
WFSP that the targets' grid needs), both COGs, maps, report.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import xarray as xr
from shapely.geometry import Point

from services.prioritization.prefire import danger_grid, soil_moisture, vegetation_2001
from shared.contracts import cog, grids, schema, tables

START = pd.Timestamp("2018-09-17T12:00:00Z")
MADE_UP = {"simulated": "true", "simulated_share": 1.0}


def make_inputs(folder: Path, vegetation: Path | None) -> dict[str, Path]:
    """Write fuels (COG on the USGS grid), weather, soil moisture and burned area; paths by input name."""
    paths = {name: folder / file for name, file in _FILES.items()}
    grid = danger_grid.UsgsGrid()
    fuels = vegetation_2001.fuels(vegetation, START.month) if vegetation else _made_up_fuels()
    bands = vegetation_2001.on_usgs_grid(fuels, grid)
    attributes = {**MADE_UP, **fuels.attrs}
    cog.write_cog(paths["fuels"], bands, transform=grid.transform, crs=grid.crs, nodata=None, attributes=attributes)
    grids.write_netcdf(paths["weather"], _weather(), MADE_UP)
    schema.write_table(paths["soil_moisture"], _soil_moisture(), tables.ALL["SOIL_MOISTURE"], MADE_UP)
    schema.write_table(paths["burned_area"], _burned_area(), tables.ALL["BURNED_AREA"], MADE_UP)
    return paths


_FILES = {
    "fuels": "fuels.tif",
    "weather": "weather.nc",
    "soil_moisture": "soil_moisture.parquet",
    "burned_area": "burned_area.parquet",
}


def _made_up_fuels() -> xr.Dataset:
    latitude, longitude = np.arange(22, 53, 1 / 6), np.arange(-130, -64, 1 / 6)
    wave = 0.5 + 0.5 * np.sin(longitude[None, :] / 3) * np.cos(latitude[:, None] / 2)
    low, high = 0.1 + 0.2 * wave, 0.4 + 0.4 * wave
    fields = {"ndvi": low + (high - low) * (0.3 + 0.4 * wave), "ndvi_min": low, "ndvi_max": high}
    return vegetation_2001.with_fuels(fields, latitude, longitude, high < 0.42)


def _weather() -> xr.Dataset:
    """Hourly weather of 0.25 degrees for 24 h: a hot dry south-west, a windy plain, rain in the east."""
    rng = np.random.default_rng(0)
    latitude, longitude = np.arange(21, 54, 0.25), np.arange(-131, -63, 0.25)
    times = pd.date_range(START.tz_localize(None) + pd.Timedelta(hours=1), periods=24, freq="h")
    shape = (24, len(latitude), len(longitude))
    cycle = np.cos((times.hour.to_numpy() - 22) * 2 * np.pi / 24)[:, None, None]
    south = ((50 - latitude) / 25)[None, :, None]
    west = ((-85 - longitude) / 40)[None, None, :]
    fields = {
        "temperature_c": 12 + 16 * south + 6 * west + 7 * cycle + rng.normal(0, 1, shape),
        "relative_humidity_pct": np.clip(62 - 32 * west - 22 * cycle + rng.normal(0, 5, shape), 4, 100),
        "wind_speed_m_s": 3 + 4 * np.exp(-(((longitude + 100) / 6) ** 2))[None, None, :] + rng.gamma(2, 0.8, shape),
        "wind_direction_deg": np.full(shape, 230.0),
        "rain_mm": np.where(west < -0.1, rng.gamma(0.2, 1.0, shape), 0.0),
    }
    data: dict[str, Any] = {name: (("time", "latitude", "longitude"), values) for name, values in fields.items()}
    data["issued_at"] = ("time", np.full(24, np.datetime64(START.tz_localize(None), "ns")))
    return xr.Dataset(data, coords={"time": times, "latitude": latitude, "longitude": longitude})


def _soil_moisture() -> pd.DataFrame:
    """Every 9 km cell up to 38 N seen in the last three days, dry in the west."""
    longitude, latitude = np.meshgrid(np.arange(-124, -68, 0.0933), np.arange(25, 38, 0.08))
    row, column = soil_moisture.ease_cells(longitude.ravel(), latitude.ravel())
    rng = np.random.default_rng(1)
    wet = 0.05 + 0.3 * np.clip((longitude.ravel() + 115) / 40, 0, 1) + rng.normal(0, 0.02, row.size)
    age = pd.to_timedelta(rng.uniform(1, 72, row.size), unit="h")
    table = pd.DataFrame({"time": START - age, "row": row, "column": column, "soil_moisture": np.clip(wet, 0.02, 0.6)})
    return table.assign(soil_moisture_sd=0.04, count=5, mode="nominal").drop_duplicates(["row", "column"])


def _burned_area() -> Any:
    """Three hundred looks at burns of the last months."""
    rng = np.random.default_rng(2)
    count = 300
    points = [Point(x, y) for x, y in zip(rng.uniform(-122, -95, count), rng.uniform(26, 38, count), strict=True)]
    frame = {
        "time": START - pd.to_timedelta(rng.uniform(1, 120, count), unit="D"),
        "along_m": 6000.0,
        "across_m": 4000.0,
    }
    frame |= {"burned_probability": 0.95, "prior_probability": 0.04, "burned": True, "confidence": 90.0}
    return geopandas.GeoDataFrame({**frame, "mode": "raw-if"}, geometry=points, crs="EPSG:4326")


def rate(folder: Path) -> dict[str, float]:
    """Run the process on the folder's inputs in this process; seconds, peak memory (GB) and what came out."""
    began = time.perf_counter()
    from services.prioritization.prefire_processes import PREFIRE_PROCESSES
    from shared.artifacts.roots import Roots
    from shared.artifacts.store import ArtifactStore
    from shared.process.execution import resolve_step, run_step

    process = next(process for process in PREFIRE_PROCESSES if process.id == "rate-prefire-danger")
    refs = {name: {"href": (folder / file).as_uri()} for name, file in _FILES.items()}
    body = {
        "fuels": refs["fuels"],
        "weather": refs["weather"],
        "soil_moisture": [refs["soil_moisture"]],
        "burned_area": [refs["burned_area"]],
        "time": START.isoformat(),
        "lead_days": 1,
        "rasters": ["wfpi"],
        "grid": "usgs-1km",
    }
    store = ArtifactStore(Roots(str(folder / "store"), (str(folder),)))
    step = resolve_step(process, process.inputs.model_validate(body), store, "bench")
    out = run_step(step, store, "owner", "job", lambda percent, message: None)
    seconds = time.perf_counter() - began
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return {
        "seconds": seconds,
        "peak_gb": peak_gb,
        "share_changed": out["share_changed"],
        "rasters": len(out["rasters"]),
    }


def measured(folder: Path) -> dict[str, float]:
    """``rate`` in a fresh interpreter."""
    command = [sys.executable, "-m", "tests.bench.prioritization.conus_day", str(folder)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(result.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    print(json.dumps(rate(Path(sys.argv[1]))))
