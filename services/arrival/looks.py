"""Looks at one fire: detections, no-fire looks and burned-area points as one set of arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.arrival.grid import FireGrid
from shared.errors import DomainError

FIRE, NO_FIRE, BURNED_AREA = 0, 1, 2
VIIRS, MODIS, OTHER_SENSOR, GNSSR = 0, 1, 2, 3
SOURCES = ("viirs", "modis", "other", "gnss-r")
DEFAULT_FOOTPRINT_M = 1000.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Looks:
    """n looks, ordered by time. Positions are local km, times hours since the product's reference time.

    `kind` FIRE | NO_FIRE | BURNED_AREA; `source` index into SOURCES; `probability` of burned (burned-area points; 1
    or 0 for the others); `radius_km` of a disc of the footprint's area; `longest_km` half the footprint's longer side.
    """

    x_km: Floats
    y_km: Floats
    time_h: Floats
    kind: NDArray[np.int8]
    source: NDArray[np.int8]
    probability: Floats
    radius_km: Floats
    longest_km: Floats

    def __len__(self) -> int:
        return self.time_h.size

    def take(self, index: NDArray[np.generic]) -> Looks:
        """The looks at `index` (integers or a mask)."""
        return replace(self, **{name: getattr(self, name)[index] for name in self.__dataclass_fields__})

    def moved(self, x_km: float, y_km: float) -> Looks:
        """The same looks in coordinates shifted by (x, y) km."""
        return replace(self, x_km=self.x_km + x_km, y_km=self.y_km + y_km)

    @property
    def fire(self) -> Looks:
        return self.take(self.kind == FIRE)

    @property
    def no_fire(self) -> Looks:
        return self.take(self.kind == NO_FIRE)

    @property
    def burned_area(self) -> Looks:
        return self.take(self.kind == BURNED_AREA)


@dataclass(frozen=True)
class Ignition:
    """Where (local km; None: unknown) and when (hours) the fire was reported to have started."""

    time_h: float
    x_km: float | None = None
    y_km: float | None = None

    def moved(self, x_km: float, y_km: float) -> Ignition:
        """The same ignition in coordinates shifted by (x, y) km."""
        if self.x_km is None or self.y_km is None:
            return self
        return replace(self, x_km=self.x_km + x_km, y_km=self.y_km + y_km)


def confident(detections: gpd.GeoDataFrame, threshold: float = 70.0) -> gpd.GeoDataFrame:
    """Detections without those fire rows whose confidence (0-100) is at most `threshold`; a null confidence passes.

    No-fire rows stay: their confidence says nothing about fire. Paper, section 5.2 (threshold > 70).
    """
    low = detections["fire"].to_numpy(bool) & (detections["confidence"].to_numpy(float) <= threshold)
    return detections[~low]


def _source_codes(instrument: pd.Series) -> NDArray[np.int8]:
    name = instrument.astype(str).str.upper()
    codes = np.select([name.str.contains("VIIRS"), name.str.contains("MODIS")], [VIIRS, MODIS], OTHER_SENSOR)
    return codes.astype(np.int8)


def positions(frame: gpd.GeoDataFrame, name: str) -> tuple[Floats, Floats]:
    """Longitude and latitude in degrees (n,) of a point table. Raises DomainError naming the first row without both."""
    lon, lat = frame.geometry.x.to_numpy(float), frame.geometry.y.to_numpy(float)
    bad = ~(np.isfinite(lon) & np.isfinite(lat))
    if bad.any():
        raise DomainError(
            f"{name}: row {int(np.flatnonzero(bad)[0])} has no finite position",
            field=f"{name}.geometry",
            value="NaN",
            accepted="degrees",
        )
    return lon, lat


def _hours(times: pd.Series, reference: pd.Timestamp) -> Floats:
    return (pd.to_datetime(times, utc=True) - reference).dt.total_seconds().to_numpy(float) / 3600.0


def looks_from_detections(detections: gpd.GeoDataFrame, grid: FireGrid, reference: pd.Timestamp) -> Looks:
    """Detections contract rows as looks on a grid; missing footprints count as 1 km. Raises DomainError at a NaN
    position."""
    lon, lat = positions(detections, "detections")
    x, y = grid.local_km(lon, lat)
    fire = detections["fire"].to_numpy(bool)
    along = detections["along_m"].fillna(DEFAULT_FOOTPRINT_M).to_numpy(float)
    across = detections["across_m"].fillna(DEFAULT_FOOTPRINT_M).to_numpy(float)
    return Looks(
        x,
        y,
        _hours(detections["time"], reference),
        np.where(fire, FIRE, NO_FIRE).astype(np.int8),
        _source_codes(detections["instrument"]),
        fire.astype(float),
        np.sqrt(along * across / np.pi) / 1e3,
        np.maximum(along, across) / 2e3,
    )


def looks_from_burned_area(points: gpd.GeoDataFrame, grid: FireGrid, reference: pd.Timestamp) -> Looks:
    """Burned-area contract rows as looks on a grid. Raises DomainError at a NaN position or probability outside
    0..1."""
    lon, lat = positions(points, "burned_area")
    stated = points["burned_probability"].to_numpy(float)
    if not ((stated >= 0) & (stated <= 1)).all():
        raise DomainError(
            "burned_area: a probability lies outside 0..1",
            field="burned_area.burned_probability",
            value="outside",
            accepted="0..1",
        )
    x, y = grid.local_km(lon, lat)
    along, across = points["along_m"].to_numpy(float), points["across_m"].to_numpy(float)
    return Looks(
        x,
        y,
        _hours(points["time"], reference),
        np.full(x.size, BURNED_AREA, np.int8),
        np.full(x.size, GNSSR, np.int8),
        _at_even_odds(stated, points),
        np.sqrt(along * across / np.pi) / 1e3,
        np.maximum(along, across) / 2e3,
    )


def _at_even_odds(stated: Floats, points: gpd.GeoDataFrame) -> Floats:
    """The probability that the look alone would give: the retrieval's own prior (where it states one) taken out.

    The share of land that burns anyway says nothing about a place beside a fire, which the other looks speak for.
    """
    if "prior_probability" not in points:
        return stated
    prior = points["prior_probability"].to_numpy(float)
    for_burned, against = stated * (1 - prior), (1 - stated) * prior
    return np.asarray(for_burned / (for_burned + against))


def merge(parts: list[Looks]) -> Looks:
    """All looks in time order, exact duplicates (same place, time, kind, source) counted once."""
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in Looks.__dataclass_fields__}
    keys = np.column_stack(
        [
            np.round(columns["x_km"], 4),
            np.round(columns["y_km"], 4),
            np.round(columns["time_h"], 4),
            columns["kind"],
            columns["source"],
        ]
    )
    _, first = np.unique(keys, axis=0, return_index=True)
    first = np.sort(first)
    order = first[np.argsort(columns["time_h"][first], kind="stable")]
    return Looks(**columns).take(order)
