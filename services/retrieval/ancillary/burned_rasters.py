"""Labels from burned-area rasters of any CRS, joined by union: MCD64A1, FireCCI51, Landsat burned area, or any other.

Coding ``day-of-year``: 1..366 the day of burning, 0 unburned, anything else not observed (MCD64A1 "Burn Date": Giglio
et al. 2018; FireCCI51 "JD": Chuvieco et al. 2018). Coding ``class``: at least ``min_value`` burned, from 0 up to it
unburned, negative not observed (Landsat burned area "BC", or "BP" with a threshold: Hawbaker et al. 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.ancillary.rasters import open_raster, sample
from services.retrieval.burned_area.labels import BURNED, EARTH_RADIUS_M, UNBURNED, UNKNOWN
from shared.errors import DomainError

DAY = np.timedelta64(86_400_000, "ms")
NEVER = np.datetime64("NaT", "ms")
RADIUS_M = 750.0  # about the first Fresnel zone with the motion of a look
KNOWN_SHARE = 0.5  # of the points of a look that some raster must have observed
MCD64A1_LAYER = "Burn Date"


@dataclass(frozen=True)
class BurnedRaster:
    """One raster and its coding; ``observed_from``..``observed_to`` bounds what its zeros say (None: no bound)."""

    path: Path
    coding: str
    year: int | None = None
    burned_on: np.datetime64 | None = None
    min_value: float = 1.0
    observed_from: np.datetime64 | None = None
    observed_to: np.datetime64 | None = None

    def __post_init__(self) -> None:
        needed = {"day-of-year": ("year", self.year), "class": ("burned_on", self.burned_on)}
        if self.coding not in needed:
            raise DomainError("No such coding.", field="coding", value=self.coding, accepted=" or ".join(needed))
        name, value = needed[self.coding]
        if value is None:
            raise DomainError(
                f"A burned-area raster of the coding '{self.coding}' needs {name}.",
                field=f"burned_rasters.{name}",
                accepted="year of the days" if name == "year" else "time from which the burned places had burned",
            )


def burn_times_at(
    raster: BurnedRaster, longitude_deg: NDArray[np.float64], latitude_deg: NDArray[np.float64]
) -> tuple[NDArray[np.datetime64], NDArray[np.bool_]]:
    """Time at which the place is known to have burned (NaT: not) and whether the raster observed it, any shape.

    A day counts as burned from its end. DomainError where the values cannot be of the coding.
    """
    with open_raster(raster.path, MCD64A1_LAYER, "burned_rasters") as source:
        value = sample(source, longitude_deg, latitude_deg)
    if raster.coding == "class":
        burned = value >= raster.min_value
        return np.where(burned, np.datetime64(raster.burned_on, "ms"), NEVER), value >= 0
    if np.nanmax(value, initial=0.0) > 366:
        raise DomainError(
            f"'{raster.path.name}' holds {np.nanmax(value):g}, which is no day of the year.",
            field="burned_rasters",
            value=float(np.nanmax(value)),
            accepted="0 unburned, 1..366 day, negative not observed",
        )
    burned = value >= 1
    first = np.datetime64(f"{raster.year}-01-01", "ms")
    times = first + np.where(burned, value, 0.0).astype(np.int64) * DAY
    return np.where(burned, times, NEVER), value >= 0


def label_by_rasters(
    looks: pd.DataFrame, rasters: Sequence[BurnedRaster], radius_m: float = RADIUS_M, uncertainty_days: float = 1.0
) -> NDArray[np.int8]:
    """BURNED, UNBURNED or UNKNOWN (n,) by the union of rasters over a disc around each look.

    A point has burned at the earliest time that any raster gives; a look is burned where at least half of its observed
    points had burned by its time. Unknown: fewer than half of the points observed at the look's time, or a verdict
    that hangs on a burn within ``uncertainty_days`` of the look.
    """
    latitude, longitude = _disc(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy(), radius_m)
    when = looks["time"].to_numpy().astype("datetime64[ms]")[:, None]
    burn = np.full(latitude.shape, np.datetime64("9999-01-01", "ms"))
    observed = np.zeros(latitude.shape, dtype=bool)
    for raster in rasters:
        times, seen = burn_times_at(raster, longitude, latitude)
        burn = np.where(np.isnat(times), burn, np.minimum(burn, times))
        observed |= seen & (_within(when, raster) | ~np.isnat(times))
    slack = np.timedelta64(round(uncertainty_days * 86_400_000), "ms")
    known = observed.sum(axis=1)
    surely = 2 * ((burn + slack <= when) & observed).sum(axis=1) >= np.maximum(known, 1)
    perhaps = 2 * ((burn - slack - DAY <= when) & observed).sum(axis=1) >= np.maximum(known, 1)
    label = np.where(surely, BURNED, np.where(perhaps, UNKNOWN, UNBURNED))
    return np.where(known >= KNOWN_SHARE * latitude.shape[1], label, UNKNOWN).astype(np.int8)


def _within(when: NDArray[np.datetime64], raster: BurnedRaster) -> NDArray[np.bool_]:
    inside = np.ones(when.shape, dtype=bool)
    if raster.observed_from is not None:
        inside &= when >= raster.observed_from
    if raster.observed_to is not None:
        inside &= when < raster.observed_to
    return inside


def _disc(latitude_deg: NDArray, longitude_deg: NDArray, radius_m: float) -> tuple[NDArray, NDArray]:
    """The centre and two rings of six points each, (n, 13)."""
    angle = np.concatenate([[0.0], np.arange(6) * np.pi / 3, np.arange(6) * np.pi / 3 + np.pi / 6])
    reach = np.rad2deg(radius_m / EARTH_RADIUS_M) * np.concatenate([[0.0], np.full(6, 0.5), np.ones(6)])
    latitude = latitude_deg[:, None] + reach * np.cos(angle)
    return latitude, longitude_deg[:, None] + reach * np.sin(angle) / np.cos(np.deg2rad(latitude_deg))[:, None]
