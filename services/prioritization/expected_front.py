"""Where a fire will be worth looking at in the next hours: its front, the ring it may reach, and where it is unsure.

From the last arrival map when there is one, with fresher detections; else from the incident's geometry and detections.
Every source gives places with a worth w in 0..1; the lattice then takes the largest in each of its cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr
from shapely.geometry.base import BaseGeometry

from services.prioritization.lattice import KM_PER_DEGREE, Lattice
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

RECENT_H = 24.0
DETECTION_MEMORY_H = 48.0
DETECTION_REACH_KM = 20.0
SPREAD_LIMITS_M_S = (0.005, 0.5)
SPREAD_UNKNOWN_M_S = 0.05
LARGEST_RING_KM = 15.0
WEIGHTLESS = 0.05
KINDS = ("front", "ring", "uncertain", "detection", "incident", "expected")
FORECAST_AGE_H = 24.0


@dataclass(frozen=True)
class Places:
    """Places with their worth and what they are: ``kind`` indexes ``KINDS``. All (n,)."""

    longitude_deg: Array
    latitude_deg: Array
    worth: Array
    kind: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Front:
    """The places of one fire, its assumed rate of spread and the time up to which its sources know.

    ``forecast``: the way ahead is the arrival map's own probability, not a ring at the rate of spread.
    """

    places: Places
    spread_m_s: float
    known_until: pd.Timestamp
    forecast: bool = False


def joined(parts: list[Places]) -> Places:
    """All places of several lists."""
    if not parts:
        none = np.empty(0)
        return Places(none, none, none, none.astype(np.int64))
    return Places(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("longitude_deg", "latitude_deg", "worth")
        ),
        np.concatenate([part.kind for part in parts]),
    )


def reference_time(arrival: xr.Dataset) -> pd.Timestamp:
    """The origin of an arrival map's seconds; DomainError if the attribute is no time."""
    try:
        stamp = pd.Timestamp(str(arrival.attrs["reference_time"]))
    except (KeyError, ValueError) as error:
        raise DomainError(
            "The arrival map has no usable reference_time.", field="fire_arrival", accepted="an ISO 8601 UTC time"
        ) from error
    return stamp.tz_localize("UTC") if stamp.tz is None else stamp.tz_convert("UTC")


def front_of_map(arrival: xr.Dataset, time: pd.Timestamp, horizon_h: float) -> Front:
    """Expected front from an arrival map: arrivals of its last 24 h, the ring reachable within ``horizon_h``, doubt.

    The rate of spread is the growth of the burned area's equivalent radius in the map's last 24 h, within 0.005-0.5
    m/s. Where the map carries ``front24_probability`` that takes the ring's place (see ``ahead_of_forecast``).
    """
    seconds = arrival["fire_arrival_time"].to_numpy().astype(np.float64)
    sd_h = np.nan_to_num(arrival["fire_arrival_time_sd"].to_numpy().astype(np.float64)) / 3600
    probability = _probabilities(arrival, "burned_probability")
    x_m, y_m = (arrival[axis].to_numpy().astype(np.float64) for axis in ("x", "y"))
    cell_m = float(np.abs(np.diff(x_m)).mean()) if len(x_m) > 1 else 500.0
    origin = reference_time(arrival)
    now_s = (time - origin).total_seconds()
    burned = np.isfinite(seconds) & (seconds <= now_s) & (probability >= 0.5)
    last_s = float(seconds[burned].max()) if burned.any() else now_s
    age_h = np.where(burned, (last_s - np.nan_to_num(seconds)) / 3600, np.inf)
    spread = _spread_m_s(int(burned.sum()), int((age_h > RECENT_H)[burned].sum()), cell_m)
    forecast = front_forecast(arrival, origin, time, horizon_h)
    if forecast is None:
        ahead = _ring(burned, cell_m, min(spread * horizon_h * 3600, LARGEST_RING_KM * 1000))
    else:
        ahead = np.where(burned, 0, ahead_of_forecast(forecast))
    front = np.where(age_h <= RECENT_H, 1 - 0.5 * np.minimum(age_h, RECENT_H) / RECENT_H, 0)
    unsure = 0.7 * np.maximum(np.clip(sd_h / 12, 0, 1) * burned, 4 * probability * (1 - probability))
    worth = np.stack([front, ahead, unsure])
    kinds = np.array([KINDS.index(k) for k in ("front", "ring" if forecast is None else "expected", "uncertain")])
    longitude, latitude = _geographic(arrival, x_m, y_m)
    best = worth.max(axis=0)
    kept = best >= WEIGHTLESS
    places = Places(longitude[kept], latitude[kept], best[kept], kinds[worth.argmax(axis=0)[kept]].astype(np.int64))
    known_until = origin + pd.Timedelta(seconds=last_s) if burned.any() else origin
    return Front(places, spread, known_until, forecast is not None)


def front_forecast(arrival: xr.Dataset, origin: pd.Timestamp, time: pd.Timestamp, horizon_h: float) -> Array | None:
    """Probability (y, x) that fire arrives within ``horizon_h``, from the map's of 24 h; None where it has none.

    None too where the map's ``end`` lies more than a day before ``time``: its forecast is over. DomainError if values
    are no probabilities.
    """
    if "front24_probability" not in arrival.variables:
        return None
    end = pd.to_datetime(str(arrival.attrs.get("end", "")), utc=True, errors="coerce")
    if not pd.isna(end) and (time - end) > pd.Timedelta(hours=FORECAST_AGE_H):
        return None
    values = _probabilities(arrival, "front24_probability")
    return 1 - (1 - values) ** (horizon_h / 24)


def _probabilities(arrival: xr.Dataset, name: str) -> Array:
    """A layer of probabilities (y, x), 0 where unknown; DomainError if its values are none (per cent, say)."""
    values = arrival[name].transpose("y", "x").to_numpy().astype(np.float64)
    least, largest = (float(f(values, initial=0.0)) for f in (np.nanmin, np.nanmax))
    if least < -1e-6 or largest > 1 + 1e-6:
        raise DomainError(
            f"The arrival map's {name} holds more than probabilities.",
            field=name,
            value=max(largest, -least),
            accepted="0..1",
        )
    return np.clip(np.nan_to_num(values), 0, 1)


def ahead_of_forecast(probability: Array) -> Array:
    """Worth of unburned places by the probability that fire arrives: 0.9 p, or 0.7 of its doubt where that is more."""
    return np.maximum(0.9 * probability, 0.7 * 4 * probability * (1 - probability))


def _ring(burned: npt.NDArray[np.bool_], cell_m: float, reach_m: float) -> Array:
    """Worth of unburned places within reach of the burned area, falling from 0.9 to 0.3."""
    from scipy.ndimage import distance_transform_edt

    if not burned.any():
        return np.zeros(burned.shape)
    distance_m = distance_transform_edt(~burned) * cell_m
    near = ~burned & (distance_m <= reach_m + cell_m)
    return np.where(near, 0.9 - 0.6 * np.minimum(distance_m / (reach_m + cell_m), 1), 0)


def _spread_m_s(cells: int, older_cells: int, cell_m: float) -> float:
    growth_m = (np.sqrt(cells / np.pi) - np.sqrt(older_cells / np.pi)) * cell_m
    return float(np.clip(growth_m / (RECENT_H * 3600), *SPREAD_LIMITS_M_S)) if cells else SPREAD_UNKNOWN_M_S


def _geographic(arrival: xr.Dataset, x_m: Array, y_m: Array) -> tuple[Array, Array]:
    from pyproj import Transformer
    from pyproj.exceptions import CRSError

    text = str(arrival["crs"].attrs.get("crs_wkt", ""))
    try:
        transform = Transformer.from_crs(text, "EPSG:4326", always_xy=True)
    except CRSError as error:
        raise DomainError(
            "The arrival map's variable 'crs' has no usable crs_wkt.",
            field="fire_arrival",
            accepted="WKT of a UTM zone",
        ) from error
    x, y = np.meshgrid(x_m, y_m)
    longitude, latitude = transform.transform(x, y)
    return np.asarray(longitude), np.asarray(latitude)


def distance_km(longitude_deg: Array, latitude_deg: Array, geometry: BaseGeometry) -> Array:
    """Distance of places from a geometry, 0 inside it; flat-Earth at the geometry's latitude, good to some 100 km."""
    import shapely
    from shapely.affinity import scale

    shrink = float(np.cos(np.radians(geometry.representative_point().y)))
    flat = scale(geometry, xfact=shrink, yfact=1.0, origin=(0, 0))
    distance: Array = shapely.distance(shapely.points(longitude_deg * shrink, latitude_deg), flat)
    return KM_PER_DEGREE * distance


def front_of_detections(
    detections: pd.DataFrame, geometry: BaseGeometry, time: pd.Timestamp, lattice: Lattice
) -> Places:
    """Fires detected near the incident in the last 48 h: worth falls by e in 24 h; the cells around get half of it."""
    known = detections[detections["fire"] & (detections["delivered_at"] <= time)]
    age_h = (time - known["time"]).dt.total_seconds().to_numpy() / 3600
    recent = (age_h >= 0) & (age_h <= DETECTION_MEMORY_H)
    known, age_h = known[recent], age_h[recent]
    near = distance_km(known.geometry.x.to_numpy(), known.geometry.y.to_numpy(), geometry) <= DETECTION_REACH_KM
    points = known.geometry[near]
    places = Places(
        points.x.to_numpy(),
        points.y.to_numpy(),
        np.exp(-age_h[near] / 24),
        np.full(int(near.sum()), KINDS.index("detection")),
    )
    return joined([places, _around(places, lattice)])


def _around(places: Places, lattice: Lattice) -> Places:
    step = lattice.height_deg
    parts = []
    for north, east in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        width = step / np.maximum(np.cos(np.radians(places.latitude_deg)), 0.1)
        ring = np.full(len(places.worth), KINDS.index("ring"))
        parts.append(
            Places(places.longitude_deg + east * width, places.latitude_deg + north * step, 0.5 * places.worth, ring)
        )
    return joined(parts)


def front_of_incident(geometry: BaseGeometry, lattice: Lattice) -> Places:
    """Without a map: a reported point with its surroundings, or the edge of a perimeter and, for less, its inside."""
    kind = KINDS.index("incident")
    if geometry.area == 0:
        point = geometry.representative_point()
        place = Places(np.array([point.x]), np.array([point.y]), np.array([1.0]), np.array([kind]))
        return joined([place, _around(place, lattice)])
    from shapely import contains_xy

    step = lattice.height_deg / 2
    edge = geometry.boundary
    along = [edge.interpolate(d) for d in np.arange(0, edge.length, step)]
    rim = np.array([[p.x, p.y] for p in along])
    west, south, east, north = geometry.bounds
    x, y = np.meshgrid(np.arange(west, east + step, step), np.arange(south, north + step, step))
    inside = contains_xy(geometry, x.ravel(), y.ravel())
    filling = np.stack([x.ravel()[inside], y.ravel()[inside]], axis=1)
    worth = np.concatenate([np.full(len(rim), 0.9), np.full(len(filling), 0.3)])
    points = np.concatenate([rim, filling])
    return Places(points[:, 0], points[:, 1], worth, np.full(len(worth), kind))
