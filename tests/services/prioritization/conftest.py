"""A small made-up region for the processes of prioritization, and a store to run them in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from shapely.geometry import Point

from shared.artifacts.reference import ArtifactRef
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import grids, schema, tables
from shared.process.execution import resolve_step, run_step

TIME = pd.Timestamp("2022-06-10T18:00:00Z")
AREA = (-109.0, 32.0, -106.0, 35.0)


def _axes(step: float) -> tuple[np.ndarray, np.ndarray]:
    west, south, east, north = AREA
    return np.arange(south + step / 2, north, step), np.arange(west + step / 2, east, step)


def make_weather(hours: int = 200, step: float = 0.25) -> xr.Dataset:
    """Hourly weather from a day before TIME: diurnal cycle, a wind gradient from south to north, no rain."""
    latitude, longitude = _axes(step)
    start = TIME.tz_localize(None) - pd.Timedelta(days=1)
    times = pd.date_range(start, periods=hours + 24, freq="h")
    local = (times.hour.to_numpy() - 7) % 24
    cycle = np.cos((local - 15) * 2 * np.pi / 24)[:, None, None]
    shape = (len(times), len(latitude), len(longitude))
    north = (latitude - latitude[0])[None, :, None]
    fields = {
        "temperature_c": 24 + 9 * cycle + 0 * north,
        "relative_humidity_pct": 30 - 18 * cycle + 0 * north,
        "wind_speed_m_s": 4 + 2 * cycle + north,
        "wind_direction_deg": np.full(shape, 240.0),
        "rain_mm": np.zeros(shape),
    }
    data = {name: (("time", "latitude", "longitude"), np.broadcast_to(v, shape).copy()) for name, v in fields.items()}
    issued = np.where(times > TIME.tz_localize(None), np.datetime64(TIME.tz_localize(None)), times)
    return xr.Dataset(
        {**data, "issued_at": ("time", issued.astype("datetime64[ns]"))},
        coords={"time": times, "latitude": latitude, "longitude": longitude},
    )


def make_fuels(step: float = 0.05) -> xr.Dataset:
    """Fuels with a band of agriculture, a lake and greenness rising eastwards."""
    latitude, longitude = _axes(step)
    shape = (len(latitude), len(longitude))
    east = np.linspace(0, 1, len(longitude))[None, :] * np.ones(shape)
    mask = np.zeros(shape, dtype=np.uint8)
    mask[:4] = 251
    mask[20:24, 20:24] = 254
    values = {
        "ndvi": 0.2 + 0.4 * east,
        "ndvi_min": np.full(shape, 0.15),
        "ndvi_max": np.full(shape, 0.75),
        "live_load": np.full(shape, 0.4),
        "dead_load": np.full(shape, 0.8),
        "extinction_pct": np.full(shape, 25.0),
        "kbdi": np.full(shape, 120.0),
        "soil_moisture_q05": np.full(shape, 0.05),
        "soil_moisture_q95": np.full(shape, 0.35),
    }
    data = {name: (("latitude", "longitude"), v) for name, v in values.items()}
    data["mask_code"] = (("latitude", "longitude"), mask)
    return xr.Dataset(data, coords={"latitude": latitude, "longitude": longitude})


def make_incidents() -> geopandas.GeoDataFrame:
    """Two fires known at TIME and one reported an hour later."""
    return geopandas.GeoDataFrame(
        {
            "incident_id": ["A", "B", "C"],
            "name": ["Alder", "Birch", "Cedar"],
            "start": [TIME - pd.Timedelta(days=2)] * 3,
            "area_km2": [12.0, np.nan, 1.0],
            "known_at": [TIME - pd.Timedelta(days=1), TIME - pd.Timedelta(hours=3), TIME + pd.Timedelta(hours=1)],
        },
        geometry=[Point(-108.2, 33.2), Point(-107.0, 34.6), Point(-107.5, 33.0)],
        crs="EPSG:4326",
    )


def make_ratings(probability: tuple[float, float] = (0.2, 0.04)) -> pd.DataFrame:
    """Ratings of the two known fires."""
    p = np.array(probability)
    return pd.DataFrame(
        {
            "incident_id": ["A", "B"],
            "time": [TIME, TIME],
            "probability": p,
            "probability_low": p * 0.7,
            "probability_high": np.minimum(p * 1.4, 1),
            "percentile": [95.0, 40.0],
            "drivers": ["wind 9 m/s (+0.8)", "KBDI 40 mm (-0.4)"],
            "out_of_domain": [False, False],
            "imputed": ["", "kbdi_mm"],
        }
    )


def make_arrival(incident: str = "A", centre: tuple[float, float] = (-108.2, 33.2), days: float = 2.0) -> xr.Dataset:
    """A circular fire grown at 0.1 m/s for ``days`` before TIME on a 500 m UTM grid (zone 12 north)."""
    from pyproj import CRS, Transformer

    crs = CRS.from_epsg(32612)
    x0, y0 = Transformer.from_crs(4326, crs, always_xy=True).transform(*centre)
    offset = np.arange(-20000, 20001, 500.0)
    x, y = np.meshgrid(offset, offset)
    reference = TIME - pd.Timedelta(days=days)
    arrival = np.hypot(x, y) / 0.1
    arrival = np.where(arrival <= days * 86400, arrival, np.nan)
    burned = np.isfinite(arrival)
    layers = {
        "fire_arrival_time": arrival,
        "fire_arrival_time_sd": np.where(burned, 3600.0, np.nan),
        "fire_arrival_time_q05": arrival - 5900,
        "fire_arrival_time_q50": arrival,
        "fire_arrival_time_q95": arrival + 5900,
        "burned_probability": burned.astype(float),
        "information": np.ones(arrival.shape),
        "latest_observation": np.full(arrival.shape, days * 86400.0),
    }
    data = {name: (("y", "x"), values) for name, values in layers.items()}
    data["crs"] = ((), 0, {"crs_wkt": crs.to_wkt()})
    attributes = {"reference_time": reference.isoformat(), "incident_id": incident}
    return xr.Dataset(data, coords={"x": x0 + offset, "y": y0 + offset}, attrs=attributes)


def make_burned_area(longitude: float, latitude: float, hours_ago: float, probability: float = 0.95) -> Any:
    """One look that found a burn."""
    return geopandas.GeoDataFrame(
        {
            "time": [TIME - pd.Timedelta(hours=hours_ago)],
            "along_m": [6000.0],
            "across_m": [4000.0],
            "burned_probability": [probability],
            "prior_probability": [0.04],
            "burned": [True],
            "confidence": [90.0],
            "mode": ["raw-if"],
        },
        geometry=[Point(longitude, latitude)],
        crs="EPSG:4326",
    )


class Room:
    """Writes inputs into a folder and runs processes of the service in a store beside it."""

    def __init__(self, folder: Path) -> None:
        self.inputs = folder / "inputs"
        self.inputs.mkdir()
        self.store = ArtifactStore(Roots(str(folder / "store"), (str(self.inputs),)))

    def _ref(self, path: Path) -> ArtifactRef:
        return ArtifactRef(href=path.as_uri())

    def grid(self, name: str, dataset: xr.Dataset) -> ArtifactRef:
        grids.write_netcdf(self.inputs / name, dataset)
        return self._ref(self.inputs / name)

    def table(self, name: str, frame: pd.DataFrame, contract: str) -> ArtifactRef:
        schema.write_table(self.inputs / name, frame, tables.ALL[contract])
        return self._ref(self.inputs / name)

    def plain(self, name: str, frame: pd.DataFrame) -> ArtifactRef:
        frame.to_parquet(self.inputs / name)
        return self._ref(self.inputs / name)

    def run(self, process_id: str, **inputs: Any) -> dict[str, Any]:
        from services.prioritization.processes import PROCESSES

        process = {process.id: process for process in PROCESSES}[process_id]
        step = resolve_step(process, process.inputs.model_validate(inputs), self.store, "test")
        return run_step(step, self.store, "owner", "job", lambda percent, message: None)

    def path(self, reference: dict[str, Any]) -> Path:
        return Path(reference["href"].removeprefix("file://"))


@pytest.fixture
def room(tmp_path: Path) -> Room:
    return Room(tmp_path)


@pytest.fixture
def make() -> dict[str, Callable[..., Any]]:
    """The makers of the region's inputs, by name (conftest modules cannot be imported)."""
    return {
        "weather": make_weather,
        "fuels": make_fuels,
        "incidents": make_incidents,
        "ratings": make_ratings,
        "arrival": make_arrival,
        "burned_area": make_burned_area,
    }


@pytest.fixture(scope="session")
def time() -> pd.Timestamp:
    return TIME


@pytest.fixture(scope="session")
def area() -> tuple[float, float, float, float]:
    return AREA
