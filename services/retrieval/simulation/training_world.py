"""Random little worlds to learn from: terrain, weather, fires and specular tracks, all from a seed.

They serve training and tests where no labelled map is to be had. Nothing here is a picture of a real place; the
demo's nature run is made elsewhere by other means.
"""

from __future__ import annotations

from dataclasses import dataclass

import geopandas
import numpy as np
import pandas as pd
import pyproj
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from services.retrieval.simulation.surface import Surface

FloatArray = NDArray[np.float64]

DAY_MS = 86_400_000
LOOKS_PER_KM2_DAY = 0.009  # eight satellites, four channels, one look a second, spread over +-38 degrees
CELL_DEG, BURN_CELL_DEG = 0.05, 0.01


@dataclass(frozen=True)
class WorldPlan:
    """What to make: a box (deg), a first day, days before and after the first ignition, number and size of fires."""

    seed: int
    latitude_deg: float
    longitude_deg: float
    size_deg: float = 2.5
    first_day: str = "2021-06-01"
    days_before: int = 30
    days_after: int = 10
    fires: int = 12
    fire_radius_km: tuple[float, float] = (4.0, 22.0)

    @property
    def first_ms(self) -> int:
        return int(np.datetime64(self.first_day, "ms").astype(np.int64))

    @property
    def ignition_ms(self) -> int:
        return self.first_ms + self.days_before * DAY_MS

    @property
    def end_ms(self) -> int:
        return self.ignition_ms + self.days_after * DAY_MS


def make_surface(plan: WorldPlan) -> Surface:
    """The surface of a world: patchy vegetation and soils, rain that dries down, fires that spread as ellipses."""
    rng = np.random.default_rng([plan.seed, 1])
    latitude = plan.latitude_deg + np.arange(0.0, plan.size_deg, CELL_DEG)
    longitude = plan.longitude_deg + np.arange(0.0, plan.size_deg, CELL_DEG)
    shape = (latitude.size, longitude.size)
    vegetation = _uniform_field(rng, shape, 4.0)
    lushness = rng.uniform(0.4, 1.1)  # grassland worlds and forest worlds
    water = np.where(_uniform_field(rng, shape, 1.5) > 0.97, rng.uniform(0.005, 0.05, shape), 0.0)
    static = {
        "vod": np.clip(lushness * vegetation**1.3 + 0.05, 0.05, 1.2),
        "roughness_cm": 0.8 + 1.9 * _uniform_field(rng, shape, 3.0),
        "clay_fraction": 0.08 + 0.35 * _uniform_field(rng, shape, 6.0),
        "water_fraction": water,
    }
    burn_latitude = plan.latitude_deg + np.arange(0.0, plan.size_deg, BURN_CELL_DEG)
    burn_longitude = plan.longitude_deg + np.arange(0.0, plan.size_deg, BURN_CELL_DEG)
    days = plan.days_before + plan.days_after
    return Surface(
        time=(plan.first_ms + np.arange(days) * DAY_MS).astype("datetime64[ms]"),
        latitude_deg=latitude,
        longitude_deg=longitude,
        soil_moisture=_moisture(rng, days, shape).astype(np.float32),
        static={name: field.astype(np.float32) for name, field in static.items()},
        burn_latitude_deg=burn_latitude,
        burn_longitude_deg=burn_longitude,
        burn_time=_burn_times(rng, plan, burn_latitude, burn_longitude),
    )


def _uniform_field(rng: np.random.Generator, shape: tuple[int, ...], smooth: float) -> FloatArray:
    """A smooth random field whose values are spread evenly over 0..1."""
    field = gaussian_filter(rng.standard_normal(shape), smooth, mode="wrap")
    return (np.argsort(np.argsort(field.ravel())) / (field.size - 1.0)).reshape(shape)


def _moisture(rng: np.random.Generator, days: int, shape: tuple[int, int]) -> FloatArray:
    dry = 0.05 + 0.08 * _uniform_field(rng, shape, 5.0)
    wetness = 0.10 * _uniform_field(rng, shape, 8.0)
    states = np.empty((days, *shape))
    for day in range(days):
        if rng.random() < 0.12:
            wetness = np.minimum(wetness + rng.uniform(0.05, 0.25) * _uniform_field(rng, shape, 7.0), 0.32)
        wetness = wetness * np.exp(-1.0 / 5.0)  # drying within five days
        states[day] = dry + wetness
    return states


def _burn_times(rng: np.random.Generator, plan: WorldPlan, latitude: FloatArray, longitude: FloatArray) -> NDArray:
    grid_latitude, grid_longitude = np.meshgrid(latitude, longitude, indexing="ij")
    arrival = np.full(grid_latitude.shape, np.inf)
    ragged = 1.0 + 0.35 * (_uniform_field(rng, grid_latitude.shape, 4.0) - 0.5)
    for _ in range(plan.fires):
        middle = plan.size_deg * rng.uniform(0.12, 0.88, 2) + np.array([plan.latitude_deg, plan.longitude_deg])
        radius_km, days, angle = rng.uniform(*plan.fire_radius_km), rng.uniform(0.5, 5.0), rng.uniform(0.0, np.pi)
        north = (grid_latitude - middle[0]) * 111.2
        east = (grid_longitude - middle[1]) * 111.2 * np.cos(np.deg2rad(middle[0]))
        along = north * np.cos(angle) + east * np.sin(angle)
        across = -north * np.sin(angle) + east * np.cos(angle)
        share = np.hypot(along, across * 1.7) * ragged / radius_km
        begin = rng.uniform(0.0, 0.3 * plan.days_after)
        arrival = np.minimum(arrival, np.where(share < 1.0, begin + share * days, np.inf))
    islands = _uniform_field(rng, arrival.shape, 2.0) > 0.93  # what fire left standing
    burnt = np.isfinite(arrival) & ~islands
    milliseconds = plan.ignition_ms + np.where(burnt, arrival, 0.0) * DAY_MS
    return np.where(burnt, milliseconds.astype("datetime64[ms]"), np.datetime64("NaT", "ms"))


def make_specular_points(plan: WorldPlan, start_ms: int, end_ms: int, stream: int) -> geopandas.GeoDataFrame:
    """A specular_points table of random tracks across the world's box between two times, one point a second."""
    rng = np.random.default_rng([plan.seed, 2, stream])
    side_km = plan.size_deg * 111.2
    area_km2 = side_km**2 * np.cos(np.deg2rad(plan.latitude_deg + plan.size_deg / 2))
    per_track = int(side_km / 6.6) + 2
    count = max(1, round(LOOKS_PER_KM2_DAY * area_km2 * (end_ms - start_ms) / DAY_MS / (0.62 * per_track)))
    second = np.arange(per_track)
    middle = plan.size_deg * rng.uniform(0.0, 1.0, (2, count))
    bearing = np.deg2rad(np.where(rng.random(count) < 0.5, rng.uniform(45, 95, count), rng.uniform(85, 135, count)))
    step_km = 6.6 * (second[None, :] - per_track / 2.0)
    latitude = plan.latitude_deg + middle[0][:, None] + step_km * np.cos(bearing)[:, None] / 111.2
    shrink = np.cos(np.deg2rad(latitude))
    longitude = plan.longitude_deg + middle[1][:, None] + step_km * np.sin(bearing)[:, None] / (111.2 * shrink)
    begin = start_ms + rng.integers(0, max(1, (end_ms - start_ms) // 1000 - per_track), count) * 1000
    table = _track_table(rng, count, per_track, begin)
    table["time"] = pd.to_datetime(table["time"], unit="ms", utc=True)
    inside = (
        (np.abs(latitude - plan.latitude_deg - plan.size_deg / 2) < plan.size_deg / 2)
        & (np.abs(longitude - plan.longitude_deg - plan.size_deg / 2) < plan.size_deg / 2)
    ).ravel()
    points = geopandas.points_from_xy(longitude.ravel(), latitude.ravel())
    frame = geopandas.GeoDataFrame(table, geometry=points, crs="EPSG:4326")[inside]
    return frame.sort_values("time", kind="stable", ignore_index=True)


def _track_table(rng: np.random.Generator, count: int, per_track: int, begin: NDArray[np.int64]) -> pd.DataFrame:
    incidence = rng.triangular(2.0, 28.0, 64.0, count)
    cosine = np.cos(np.deg2rad(incidence))
    satellite, transmitter = rng.integers(1, 9, count), rng.integers(1, 33, count)
    columns = {
        "satellite": np.array([f"CYGFM{n:02d}" for n in satellite], dtype=object),
        "transmitter": np.array([f"G{n:02d}" for n in transmitter], dtype=object),
        "incidence_deg": incidence,
        "rx_gain_dbi": np.clip(rng.normal(8.5, 3.6, count), 0.5, 15.0),
        "rx_range_m": 525e3 / (0.25 + 0.75 * cosine),
        "tx_range_m": 20_200e3 + 3_000e3 * (1.0 - cosine),
        "nominal": np.ones(count, dtype=bool),
    }
    table = pd.DataFrame({name: np.repeat(values, per_track) for name, values in columns.items()})
    return table.assign(time=np.repeat(begin, per_track) + np.tile(np.arange(per_track) * 1000, count))


def make_soil_moisture(plan: WorldPlan, surface: Surface, noise: float = 0.04) -> pd.DataFrame:
    """What a radiometer such as SMAP would say of the world at 6 h of each day: cells of ``surface`` averaged to 9 km.

    A table ``time``, ``row``, ``column``, ``soil_moisture`` with an error of ``noise`` m3/m3 (SMAP's requirement).
    """
    latitude, longitude = np.meshgrid(surface.latitude_deg, surface.longitude_deg, indexing="ij")
    x, y = pyproj.Transformer.from_crs(4326, 6933, always_xy=True).transform(longitude.ravel(), latitude.ravel())
    row = np.floor((7_314_540.83 - np.asarray(y)) / 9008.055210146).astype(np.int64)
    column = np.floor((np.asarray(x) + 17_367_530.44516138) / 9008.055210146).astype(np.int64)
    rng = np.random.default_rng([plan.seed, 4])
    days = []
    for day, values in zip(surface.time, surface.soil_moisture, strict=True):
        table = pd.DataFrame({"row": row, "column": column, "soil_moisture": values.ravel().astype(np.float64)})
        table = table.groupby(["row", "column"], as_index=False).mean()
        table["soil_moisture"] = np.clip(table["soil_moisture"] + rng.normal(0.0, noise, len(table)), 0.02, 0.65)
        days.append(table.assign(time=day + np.timedelta64(6 * 3_600_000, "ms")))
    return pd.concat(days, ignore_index=True)


def make_images(points: pd.DataFrame, share: float, seed: int) -> pd.DataFrame:
    """An as_run table of raw-IF seconds: a random share of the satellite-seconds of specular points."""
    seconds = points[["satellite", "time"]].drop_duplicates().sort_values(["time", "satellite"], ignore_index=True)
    kept = seconds[np.random.default_rng([seed, 3]).random(len(seconds)) < share].reset_index(drop=True)
    start = kept["time"].dt.floor("s")
    return pd.DataFrame(
        {
            "satellite": kept["satellite"],
            "start": start,
            "end": start + pd.Timedelta(seconds=1),
            "image_id": np.arange(len(kept), dtype=np.int32),
            "status": "downlinked",
            "downlinked_at": start + pd.Timedelta(hours=3),
            "station": "hawaii",
        }
    )
