"""Synthetic fires with known arrival times, and what satellites would have seen of them.

A fire spreads for days over a 30 km square: an ellipse along a changing wind, over uneven fuel, faster by day. Polar
overpasses look at it through moving cloud, miss part of what burns, and place it with jitter. The fire's residence
time, wind, fuel, cloudiness and detection rates are drawn per seed, so that an inference cannot know them.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import pandas as pd
from pyproj import Transformer
from scipy.ndimage import gaussian_filter

SIDE_KM = 30.0
CELL_KM = 0.3
STEP_H = 0.25
DIRECTIONS = [
    *((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)),
    *((1, 2), (2, 1), (-1, 2), (-2, 1), (1, -2), (2, -1), (-1, -2), (-2, -1)),
]


@dataclass(frozen=True)
class SyntheticFire:
    """Truth and looks of one fire: `arrival_h` (y, x) hours since `start`, NaN where it did not burn by `days`."""

    seed: int
    start: pd.Timestamp
    x_m: np.ndarray
    y_m: np.ndarray
    crs: str
    arrival_h: np.ndarray
    residence_h: float
    detections: gpd.GeoDataFrame
    burned_area: gpd.GeoDataFrame
    incidents: gpd.GeoDataFrame
    end: pd.Timestamp


def smooth_noise(rng: np.random.Generator, size: int, sigma: float) -> np.ndarray:
    field = gaussian_filter(rng.standard_normal((size, size)), sigma, mode="wrap")
    return field / field.std()


def directional_progress(rng: np.random.Generator, hours: float) -> list[list[float]]:
    """Kilometres that a front on unit fuel has run in each direction by each quarter hour (monotone)."""
    times = np.arange(0.0, hours + STEP_H, STEP_H)
    walk = gaussian_filter(np.cumsum(rng.normal(0, 0.12, times.size)), 12)
    wind = rng.uniform(0, 2 * np.pi) + walk
    eccentricity = np.clip(0.75 + 0.15 * gaussian_filter(rng.standard_normal(times.size), 24) * 5, 0.4, 0.92)
    clock = 0.12 + np.clip(np.sin(2 * np.pi * (times - rng.uniform(5, 9)) / 24), 0, None) ** rng.uniform(1, 2)
    head_km_h = rng.uniform(0.15, 0.4) * clock
    return run_by_direction(head_km_h, wind, eccentricity)


def run_by_direction(head_km_h: np.ndarray, wind: np.ndarray, eccentricity: np.ndarray) -> list[list[float]]:
    """Kilometres run in each of `DIRECTIONS` by each quarter hour, by ellipses along the wind (radians)."""
    progress = []
    for row, column in DIRECTIONS:
        off = np.arctan2(row, column) - wind
        speed = head_km_h * (1 - eccentricity) / (1 - eccentricity * np.cos(off))
        progress.append(np.concatenate([[0.0], np.cumsum(speed[:-1] * STEP_H)]).tolist())
    return progress


def spread(fuel: np.ndarray, start_cell: tuple[int, int], progress: list[list[float]], hours: float) -> np.ndarray:
    """Earliest arrival, hours, by shortest time over 16 neighbours with speeds that change in time."""
    arrival = np.full(fuel.shape, np.inf)
    arrival[start_cell] = 0.0
    queue = [(0.0, start_cell[0], start_cell[1])]
    fuel_rows = fuel.tolist()
    lengths = [CELL_KM * float(np.hypot(r, c)) for r, c in DIRECTIONS]
    rows, columns = fuel.shape
    while queue:
        time_h, row, column = heapq.heappop(queue)
        if time_h > arrival[row, column] or time_h >= hours:
            continue
        base, part = int(time_h / STEP_H), (time_h / STEP_H) % 1.0
        for (d_row, d_column), length, run in zip(DIRECTIONS, lengths, progress, strict=True):
            r, c = row + d_row, column + d_column
            if not (0 <= r < rows and 0 <= c < columns) or fuel_rows[r][c] <= 0:
                continue
            done = run[base] + part * (run[base + 1] - run[base])
            need = done + length / fuel_rows[r][c]
            index = bisect_left(run, need)
            if index >= len(run):
                continue
            reached = (index - 1 + (need - run[index - 1]) / max(run[index] - run[index - 1], 1e-12)) * STEP_H
            if reached < arrival[r, c]:
                arrival[r, c] = reached
                heapq.heappush(queue, (reached, r, c))
    return np.where(arrival <= hours, arrival, np.nan)


def _overpasses(rng: np.random.Generator, days: int) -> list[tuple[float, str, str, float]]:
    """(hours since start, satellite, instrument, pixel km) of each pass: two VIIRS and two MODIS, day and night."""
    solar_offset = rng.uniform(0, 24)
    fleet = [
        ("SUOMI NPP", "VIIRS", 0.375, 13.5),
        ("NOAA 20", "VIIRS", 0.375, 12.7),
        ("AQUA", "MODIS", 1.0, 13.6),
        ("TERRA", "MODIS", 1.0, 10.5),
    ]
    passes = []
    for satellite, instrument, pixel_km, local in fleet:
        for day in range(-1, days + 1):
            for half in (0.0, 12.0):
                time_h = day * 24 + local + half - solar_offset + rng.uniform(-0.8, 0.8)
                if 0 <= time_h <= days * 24 and rng.random() < 0.85:
                    passes.append((time_h, satellite, instrument, pixel_km))
    return sorted(passes)


@dataclass(frozen=True)
class Sky:
    """Cloud over the square: two fields (100, 100) that drift with the wind aloft and turn into each other."""

    fields: np.ndarray
    drift_km_h: np.ndarray
    turn_h: float

    side_km: float = SIDE_KM

    def at(self, time_h: float) -> np.ndarray:
        """Thickness of the cloud (100, 100) at a time; any unit."""
        phase = 2 * np.pi * time_h / self.turn_h
        now = np.cos(phase) * self.fields[0] + np.sin(phase) * self.fields[1]
        rows, columns = np.rint(self.drift_km_h * time_h * 100 / self.side_km).astype(int)
        return np.roll(now, (rows, columns), axis=(0, 1))


def _sky(rng: np.random.Generator, side_km: float) -> Sky:
    heading, speed = rng.uniform(0, 2 * np.pi), rng.uniform(2, 15)
    drift = speed * np.array([np.sin(heading), np.cos(heading)])
    return Sky(np.stack([smooth_noise(rng, 100, 8) for _ in range(2)]), drift, float(rng.uniform(18, 48)), side_km)


def _look(rng, arrival_h, cell, residence_h, time_h, pixel_km, detect, cloudiness, sky, viewing):
    """One granule: pixel centres (km) seen through cloud, and whether fire was seen in each. `cell` is in km."""
    size = int(sky.side_km / pixel_km) - 1
    origin = rng.uniform(0, pixel_km, 2)
    row = origin[0] + pixel_km * (np.arange(size) + 0.5)
    column = origin[1] + pixel_km * (np.arange(size) + 0.5)
    yy, xx = np.meshgrid(row, column, indexing="ij")
    burning = (arrival_h <= time_h) & (time_h < arrival_h + residence_h)
    hot = np.zeros(yy.shape, bool)
    age = np.full(yy.shape, np.inf)
    steps = np.linspace(-0.5, 0.5, max(int(np.ceil(pixel_km / cell)), 1) + 2)[1:-1] * pixel_km
    for dy in steps:
        for dx in steps:
            i = np.clip(((yy + dy) / cell).astype(int), 0, arrival_h.shape[0] - 1)
            j = np.clip(((xx + dx) / cell).astype(int), 0, arrival_h.shape[1] - 1)
            hot |= burning[i, j]
            age = np.fmin(age, np.where(burning[i, j], time_h - arrival_h[i, j], np.inf))
    fade = 1 - viewing.fading * np.clip(age / residence_h, 0, 1)  # a cooling pixel is missed more often
    seen_fire = hot & (rng.random(hot.shape) < detect * np.where(np.isfinite(age), fade, 0))
    cloud = sky.at(time_h)
    clear = cloud[(yy / sky.side_km * 99).astype(int), (xx / sky.side_km * 99).astype(int)] > np.quantile(
        cloud, cloudiness
    )
    jitter = rng.normal(0, viewing.jitter * max(pixel_km, 0.375), (2, *yy.shape))
    return yy[clear] + jitter[0][clear], xx[clear] + jitter[1][clear], seen_fire[clear]


def _burned_area(rng, arrival_h, end_h, tracks, delay_h, noise):
    """Rows (y_km, x_km, t_h, probability, burned) of CYGNSS-like tracks, 5 km by 1 km.

    No look comes earlier than `delay_h` after the start, since burned area is known late. `noise` (logits) is about 1
    for raw-IF and larger for nominal retrievals.
    """
    rows = []
    for _ in range(tracks):
        time_h = rng.uniform(min(delay_h, end_h * 0.9), end_h)
        centre, angle = rng.uniform(8, SIDE_KM - 8, 2), rng.uniform(0, np.pi)
        for s in np.arange(-14, 14, 6.5 / 2):
            y, x = centre + s * np.array([np.sin(angle), np.cos(angle)])
            if not (1 < y < SIDE_KM - 1 and 1 < x < SIDE_KM - 1):
                continue
            i, j = int(y / CELL_KM), int(x / CELL_KM)
            window = arrival_h[max(i - 4, 0) : i + 5, max(j - 4, 0) : j + 5]
            share = float(np.mean(window <= time_h))
            probability = float(1 / (1 + np.exp(-(4 * (share - 0.5) + rng.normal(0, noise)))))
            rows.append((y, x, time_h, probability, probability >= 0.5))
    return rows


@dataclass(frozen=True)
class Viewing:
    """What differs from the usual way of looking at a fire: hours that a place burns and detection rates by
    instrument (None: drawn), share of the passes that came, satellites that came, how much larger a pass's pixels may
    be than at nadir, how much less often a cooling pixel is seen, and the sd of positions in pixels."""

    residence_h: float | None = None
    detect: dict[str, float] | None = None
    kept: float = 1.0
    satellites: tuple[str, ...] = ()
    widest: float = 1.0
    seed: int = 0
    fading: float = 0.6
    jitter: float = 0.15

    def chosen(self, passes: list[tuple[float, str, str, float]]) -> list[tuple[float, str, str, float]]:
        """The passes that came, with their pixel sizes."""
        if self.kept == self.widest == 1.0 and not self.satellites:
            return passes
        rng = np.random.default_rng(self.seed)
        came = [entry for entry in passes if not self.satellites or entry[1] in self.satellites]
        came = [entry for entry in came if rng.random() < self.kept] or came[-3:]
        return [(*entry[:3], entry[3] * rng.uniform(1.0, self.widest)) for entry in came]


AS_USUAL = Viewing()


def _granules(
    rng: np.random.Generator,
    seed: int,
    arrival_h: np.ndarray,
    cell_km: float,
    residence_h: float,
    days: int,
    cloudiness: float,
    detect: dict[str, float],
    viewing: Viewing,
) -> pd.DataFrame:
    """All looks (y_km, x_km, t_h, fire, ...) of all passes over a fire."""
    sky = _sky(np.random.default_rng(seed + 700_000), cell_km * arrival_h.shape[0])
    rows = []
    for time_h, satellite, instrument, pixel_km in viewing.chosen(_overpasses(rng, days)):
        share = float(np.clip(cloudiness + rng.normal(0, 0.2), 0, 1)) if cloudiness < 0.9 else cloudiness
        y, x, seen = _look(
            rng, arrival_h, cell_km, residence_h, time_h, pixel_km, detect[instrument], share, sky, viewing
        )
        where = {"y_km": y, "x_km": x, "t_h": time_h, "fire": seen, "satellite": satellite, "instrument": instrument}
        rows.append(pd.DataFrame({**where, "along_m": pixel_km * 1e3, "across_m": pixel_km * 1e3}))
    return pd.concat(rows, ignore_index=True)


def _thin(rng: np.random.Generator, looks: pd.DataFrame, observations: int) -> pd.DataFrame:
    """All looks with fire and as many others, at random, as fit (at least half of `observations`)."""
    keep = np.flatnonzero(looks["fire"].to_numpy())
    others = np.flatnonzero(~looks["fire"].to_numpy())
    spare = max(observations - keep.size, observations // 2)
    chosen = np.sort(np.concatenate([keep, rng.choice(others, min(spare, others.size), replace=False)]))
    return looks.iloc[chosen].reset_index(drop=True)


def _detections(looks: pd.DataFrame, start: pd.Timestamp, place: Place) -> gpd.GeoDataFrame:
    times = start + pd.to_timedelta(looks["t_h"], unit="h")
    return gpd.GeoDataFrame(
        {
            "time": times.dt.floor("ms"),
            "delivered_at": (times + pd.Timedelta(hours=3)).dt.floor("ms"),
            "satellite": looks["satellite"],
            "instrument": looks["instrument"],
            "confidence": np.where(looks["fire"], 90.0, np.nan),
            "frp_mw": np.where(looks["fire"], 20.0, np.nan),
            "fire": looks["fire"],
            "along_m": looks["along_m"],
            "across_m": looks["across_m"],
        },
        geometry=place.points(looks["x_km"].to_numpy(float), looks["y_km"].to_numpy(float)),
        crs="EPSG:4326",
    )


@dataclass(frozen=True)
class Place:
    """Where on Earth a fire lies: UTM zone and the square's corner."""

    zone: int
    corner_m: tuple[float, float]

    def points(self, x_km: np.ndarray, y_km: np.ndarray) -> np.ndarray:
        transform = Transformer.from_crs(f"EPSG:326{self.zone:02d}", "EPSG:4326", always_xy=True)
        return gpd.points_from_xy(*transform.transform(self.corner_m[0] + x_km * 1e3, self.corner_m[1] + y_km * 1e3))


def observed(
    seed: int,
    rng: np.random.Generator,
    arrival_h: np.ndarray,
    cell_km: float,
    start_cell: tuple[int, int],
    days: int,
    observations: int | None,
    tracks: int,
    cloudiness: float | None,
    place: Place,
    delay_h: float,
    noise: float = 1.0,
    mode: str = "raw-if",
    viewing: Viewing = AS_USUAL,
) -> SyntheticFire:
    """A fire of known arrival (square array, hours; NaN unburned) and the tables that satellites make of it."""
    residence_h = float(rng.uniform(4, 12))
    residence_h = viewing.residence_h or residence_h
    cloudiness = float(rng.uniform(0.05, 0.45)) if cloudiness is None else cloudiness
    detect = {"VIIRS": float(rng.uniform(0.6, 0.75)), "MODIS": float(rng.uniform(0.4, 0.5))}
    detect = viewing.detect or detect
    looks = _granules(rng, seed, arrival_h, cell_km, residence_h, days, cloudiness, detect, viewing)
    if observations is not None:
        looks = _thin(rng, looks, observations)
    start = pd.Timestamp("2022-06-01T18:00Z")
    hours = days * 24.0
    points = []
    if tracks:
        points = _burned_area(np.random.default_rng(seed + 500_000), arrival_h, hours, tracks, delay_h, noise)
    ba = pd.DataFrame(points, columns=["y_km", "x_km", "t_h", "burned_probability", "burned"])
    burned_area = gpd.GeoDataFrame(
        {
            "time": start + pd.to_timedelta(ba["t_h"].astype(float), unit="h"),
            "along_m": 5000.0,
            "across_m": 1000.0,
            "burned_probability": ba["burned_probability"].astype(float),
            "burned": ba["burned"].astype(bool),
            "confidence": 80.0,
            "mode": mode,
        },
        geometry=place.points(ba["x_km"].to_numpy(float), ba["y_km"].to_numpy(float)),
        crs="EPSG:4326",
    )
    centre_km = (np.array(start_cell) + 0.5) * cell_km
    incidents = gpd.GeoDataFrame(
        {
            "incident_id": [f"synthetic-{seed}"],
            "name": ["synthetic"],
            "start": [start],
            "area_km2": [np.nan],
            "known_at": [start + pd.Timedelta(hours=2)],
        },
        geometry=place.points(centre_km[1:], centre_km[:1]),
        crs="EPSG:4326",
    )
    sides = zip(place.corner_m, arrival_h.shape[::-1], strict=True)
    x_m, y_m = (low + (np.arange(n) + 0.5) * cell_km * 1e3 for low, n in sides)
    end = start + pd.Timedelta(hours=hours)
    detections = _detections(looks, start, place)
    crs = f"EPSG:326{place.zone:02d}"
    return SyntheticFire(seed, start, x_m, y_m, crs, arrival_h, residence_h, detections, burned_area, incidents, end)


def make_fire(
    seed: int,
    observations: int | None = 5000,
    days: int = 5,
    zone: int = 13,
    tracks: int = 0,
    cloudiness: float | None = None,
    corner_m: tuple[float, float] = (400_000.0, 3_700_000.0),
    delay_h: float = 24.0,
    noise: float = 1.0,
    mode: str = "raw-if",
) -> SyntheticFire:
    """One fire and about `observations` looks at it (None: every pixel of every pass); the same seed gives the same
    fire."""
    rng = np.random.default_rng(seed)
    size = int(SIDE_KM / CELL_KM)
    fuel = np.exp(0.45 * smooth_noise(rng, size, 6))
    fuel[smooth_noise(rng, size, 5) > 2.0] = 0.0
    start_cell = (int(rng.uniform(0.35, 0.65) * size), int(rng.uniform(0.35, 0.65) * size))
    fuel[start_cell] = 1.0
    hours = days * 24.0
    progress = directional_progress(rng, hours)
    arrival_h = spread(fuel, start_cell, progress, hours)
    place = Place(zone, corner_m)
    return observed(
        seed, rng, arrival_h, CELL_KM, start_cell, days, observations, tracks, cloudiness, place, delay_h, noise, mode
    )
