"""A seeded planning case of any number of satellites and targets, for benchmarks of scale.

Circular orbits at 520 km and 35 degrees inclination in as many planes as needed, eight satellites a plane; three
stations as in the paper; every satellite sees up to four specular points, whose offsets from the sub-satellite point
drift slowly as the transmitters move. Targets lie on a grid between 24 and 38 degrees north over North America; a share
of 0.7 per cent of them are active fires. A target is covered within 12.5 km of a specular point. Simulated throughout.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from shared.contracts.spacecraft import Spacecraft

EARTH_KM, HEIGHT_KM, INCLINATION = 6371.0, 520.0, np.radians(35.0)
PERIOD_S, DAY_S, SIDEREAL_S = 5700.0, 86400, 86164.1
REACH_KM, MASK = 12.5, np.radians(5.0)
STATIONS = {"hawaii": (19.0, -155.6), "santiago": (-33.1, -70.7), "dongara": (-29.0, 115.3)}
START = pd.Timestamp("2026-08-01", tz="UTC")


def _unit(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], -1)


def _track(index: int, rng: np.random.Generator) -> np.ndarray:
    """(86400, 3) Earth-fixed unit vectors to one satellite."""
    time = np.arange(DAY_S)
    node = 2 * np.pi * (index // 8) * 0.37 + rng.uniform(0, 0.2)
    phase = 2 * np.pi * ((index % 8) / 8 + time / PERIOD_S) + rng.uniform(0, 0.3)
    spin = node - 2 * np.pi * time / SIDEREAL_S
    x, y, z = np.cos(phase), np.sin(phase) * np.cos(INCLINATION), np.sin(phase) * np.sin(INCLINATION)
    return np.stack([x * np.cos(spin) - y * np.sin(spin), x * np.sin(spin) + y * np.cos(spin), z], -1)


def _passes(track: np.ndarray, latitude: float, longitude: float) -> list[tuple[int, int]]:
    site = _unit(np.radians(latitude), np.radians(longitude))
    line = track * (EARTH_KM + HEIGHT_KM) - site * EARTH_KM
    up = (line @ site) / np.linalg.norm(line, axis=1)
    seen = np.concatenate([[False], up > np.sin(MASK), [False]])
    edges = np.flatnonzero(seen[1:] != seen[:-1])
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _specular(track: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(seconds, 4, 3) unit vectors: offsets of up to 5 degrees that turn once in a few hours."""
    time = np.arange(len(track))[:, None]
    reach = np.radians(rng.uniform(0.5, 5.0, 4))
    turn = 2 * np.pi * (time / rng.uniform(9000, 20000, 4) + rng.uniform(0, 1, 4))
    along = np.gradient(track, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(track, along)
    point = track[:, None, :] + reach[None, :, None] * (
        np.cos(turn)[..., None] * along[:, None, :] + np.sin(turn)[..., None] * across[:, None, :]
    )
    return np.asarray(point / np.linalg.norm(point, axis=2, keepdims=True))


def fleet_case(satellites: int, targets: int, seed: int = 7) -> tuple[dict[str, pd.DataFrame], Spacecraft]:
    """Contract tables and spacecraft of the case; the same arguments give the same case."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(targets / (60 * 14)) * 60)), int(np.ceil(np.sqrt(targets / (60 * 14)) * 14))
    grid = np.stack(np.meshgrid(np.linspace(-125, -65, side[0]), np.linspace(24, 38, side[1])), -1).reshape(-1, 2)
    places = np.radians(grid[np.sort(rng.choice(len(grid), targets, replace=False))])
    tree = cKDTree(_unit(places[:, 1], places[:, 0]))
    rows, contacts, eclipses, image = [], [], [], 0
    for index in range(satellites):
        name = f"SAT{index + 1:02d}"
        track = _track(index, rng)
        for station, (latitude, longitude) in STATIONS.items():
            contacts += [(name, station, begin, end) for begin, end in _passes(track, latitude, longitude)]
        shade = rng.uniform(0, PERIOD_S)
        eclipses += [(name, b, b + 2100.0) for b in np.arange(shade - PERIOD_S, DAY_S, PERIOD_S)]
        points = _specular(track, rng)
        second, hits = _seen(points, tree)
        for when, seen in zip(second, hits, strict=True):
            rows.append((name, int(when), image, seen))
            image += 1
    return _tables(rows, contacts, eclipses, targets, rng), _craft()


def _seen(points: np.ndarray, tree: cKDTree) -> tuple[np.ndarray, list[np.ndarray]]:
    """Seconds at which something is covered, with the targets."""
    latitude, longitude = np.degrees(np.arcsin(points[..., 2])), np.degrees(np.arctan2(points[..., 1], points[..., 0]))
    near = ((latitude > 23) & (latitude < 39) & (longitude > -126) & (longitude < -64)).any(axis=1)
    second = np.flatnonzero(near)
    found = tree.query_ball_point(points[second].reshape(-1, 3), REACH_KM / EARTH_KM).reshape(-1, 4)
    hits = [np.unique(np.concatenate([np.asarray(part, np.int64) for part in row])) for row in found]
    filled = np.array([len(hit) > 0 for hit in hits], bool)
    return second[filled], [hit for hit in hits if len(hit)]


def _tables(
    rows: list[Any], contacts: list[Any], eclipses: list[Any], targets: int, rng: np.random.Generator
) -> dict[str, pd.DataFrame]:
    size = np.array([len(row[3]) for row in rows])
    seconds = np.repeat([row[1] for row in rows], size)
    active = rng.uniform(size=targets) < 0.007
    spans = {
        name: pd.DataFrame(table, columns=["satellite", *columns, "start", "end"])
        for name, table, columns in (("contacts", contacts, ["station"]), ("eclipses", eclipses, []))
    }
    for frame in spans.values():
        for edge in ("start", "end"):
            frame[edge] = START + pd.to_timedelta(frame[edge], unit="s")
    return {
        "opportunities": pd.DataFrame({
            "image_id": np.repeat([row[2] for row in rows], size).astype(np.int32),
            "satellite": np.repeat([row[0] for row in rows], size),
            "time": START + pd.to_timedelta(seconds, unit="s"), "target_id": np.concatenate([row[3] for row in rows]),
        }),
        "targets": pd.DataFrame({
            "target_id": np.arange(targets), "kind": np.where(active, "active", "prefire"),
            "priority": np.where(active, rng.uniform(20.0, 40.0, targets), rng.gamma(2.0, 1.2, targets).clip(0, 19)),
        }),
        "contacts": spans["contacts"].assign(max_elevation_deg=30.0),
        "eclipses": spans["eclipses"].assign(kind="umbra"),
    }  # fmt: skip


def _craft() -> Spacecraft:
    return Spacecraft.model_validate({
        "storage_images": 60, "downlink_s_per_image": 20, "battery_capacity_wh": 90.0, "battery_min_wh": 60.0,
        "battery_initial_wh": 85.0, "generation_w": 40.0, "nominal_w": 20.0, "collect_w": 15.0, "downlink_w": 25.0,
        "horizon_start": START.to_pydatetime(), "horizon_s": DAY_S,
    })  # fmt: skip
