"""The surface as the radar meets it: a daily state, static properties, and what fire does to them.

A sample sees the last daily state at or before its own time, and a burn only if the fire had arrived by then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from services.retrieval.ancillary.burn_grid import burn_times
from shared.errors import DomainError

FloatArray = NDArray[np.float64]
TimeArray = NDArray[np.datetime64]

STATIC_FIELDS = ("vod", "roughness_cm", "clay_fraction", "water_fraction")

# What fire does, as ranges over places (severity 0..1 spans each range).
VEGETATION_LOSS = (0.55, 0.90)  # share of the vegetation optical depth that burns
ROUGHNESS_GAIN = (0.05, 0.30)  # relative rise of the surface height deviation: ash pits, uneven litter loss
MOISTURE_LOSS = (0.05, 0.25)  # relative loss of near-surface soil moisture

PLACE_ROUGHNESS_SPREAD = 0.22  # log-sd of sub-grid roughness, fixed to the place (about 3 km)
RELIEF_LOSS_DB = (
    2.0,
    9.0,
)  # coherent power lost to relief within the Fresnel zone, fixed to the place: land that is flat
# to centimetres over 600 m is rare, and without this loss the maps are 5 dB brighter than the real ones over Texas


@dataclass(frozen=True)
class SurfaceState:
    """What lies under footprint points, all arrays of one shape: moisture m3/m3, roughness cm, fractions 0..1."""

    soil_moisture: FloatArray
    vod: FloatArray
    roughness_cm: FloatArray
    clay_fraction: FloatArray
    water_fraction: FloatArray
    relief_loss_db: FloatArray
    burned: NDArray[np.bool_]


@dataclass(frozen=True)
class Surface:
    """Nature's surface on a regular grid (time, latitude, longitude) and burn times on a finer one (NaT: unburned)."""

    time: TimeArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    soil_moisture: NDArray[np.float32]
    static: dict[str, NDArray[np.float32]]
    burn_latitude_deg: FloatArray
    burn_longitude_deg: FloatArray
    burn_time: TimeArray

    def covers(self, latitude_deg: FloatArray, longitude_deg: FloatArray, time: TimeArray) -> NDArray[np.bool_]:
        """True where a state exists: inside the grid and not before the first state. One shape in, the same out."""
        inside = _inside(self.latitude_deg, latitude_deg) & _inside(self.longitude_deg, longitude_deg)
        return inside & (time >= self.time[0])

    def at(self, latitude_deg: FloatArray, longitude_deg: FloatArray, time: TimeArray) -> SurfaceState:
        """The state at points (any one shape) at their times; points beyond the edge take the edge's values."""
        day = np.maximum(np.searchsorted(self.time, time, side="right") - 1, 0)
        row, column = _nearest(self.latitude_deg, latitude_deg), _nearest(self.longitude_deg, longitude_deg)
        static = {name: field[row, column].astype(np.float64) for name, field in self.static.items()}
        moisture = self.soil_moisture[day, row, column].astype(np.float64)
        burned = self.is_burned(latitude_deg, longitude_deg, time)
        roughness = static["roughness_cm"] * _place_roughness(latitude_deg, longitude_deg)
        severity = np.where(burned, _severity(latitude_deg, longitude_deg), 0.0)
        return SurfaceState(
            soil_moisture=np.where(burned, moisture * (1.0 - _within(MOISTURE_LOSS, severity)), moisture),
            vod=np.where(burned, static["vod"] * (1.0 - _within(VEGETATION_LOSS, severity)), static["vod"]),
            roughness_cm=np.where(burned, roughness * (1.0 + _within(ROUGHNESS_GAIN, severity)), roughness),
            clay_fraction=static["clay_fraction"],
            water_fraction=static["water_fraction"],
            relief_loss_db=_relief_loss_db(latitude_deg, longitude_deg),
            burned=burned,
        )

    def is_burned(self, latitude_deg: FloatArray, longitude_deg: FloatArray, time: TimeArray) -> NDArray[np.bool_]:
        """True where fire had arrived at or before ``time``."""
        row = _nearest(self.burn_latitude_deg, latitude_deg)
        column = _nearest(self.burn_longitude_deg, longitude_deg)
        inside = _inside(self.burn_latitude_deg, latitude_deg) & _inside(self.burn_longitude_deg, longitude_deg)
        return inside & (self.burn_time[row, column] <= time)  # NaT compares false


def read_surface(path: str) -> Surface:
    """Read a surface netCDF: ``soil_moisture`` (time, latitude, longitude), static fields, ``burn_time``.

    ``burn_time`` is datetime or seconds since the attribute ``reference_time``, on ``latitude_burn`` x
    ``longitude_burn`` (or on the coarse grid). DomainError names what is missing.
    """
    try:
        with xr.open_dataset(path) as opened:
            dataset = opened.load()
    except (OSError, ValueError) as error:
        raise DomainError(f"The surface cannot be read as netCDF: {error}", field="surface") from error
    missing = [n for n in ("time", "soil_moisture", "burn_time", *STATIC_FIELDS) if n not in dataset.variables]
    if missing:
        raise DomainError(
            f"The surface lacks {', '.join(missing)}.",
            field="surface",
            value=", ".join(map(str, dataset.variables)),
            accepted="time, soil_moisture, burn_time, " + ", ".join(STATIC_FIELDS),
        )
    return from_dataset(dataset)


def from_dataset(dataset: xr.Dataset) -> Surface:
    """A Surface from a loaded dataset; axes are sorted ascending."""
    dataset = dataset.sortby(["time", "latitude", "longitude"])
    burn_time, burn_latitude_deg, burn_longitude_deg = burn_times(dataset)
    return Surface(
        time=dataset["time"].to_numpy().astype("datetime64[ms]"),
        latitude_deg=dataset["latitude"].to_numpy().astype(np.float64),
        longitude_deg=_east_west(dataset["longitude"].to_numpy()),
        soil_moisture=dataset["soil_moisture"].transpose("time", "latitude", "longitude").to_numpy().astype(np.float32),
        static={n: dataset[n].transpose("latitude", "longitude").to_numpy().astype(np.float32) for n in STATIC_FIELDS},
        burn_latitude_deg=burn_latitude_deg,
        burn_longitude_deg=burn_longitude_deg,
        burn_time=burn_time,
    )


def _east_west(longitude: NDArray) -> FloatArray:
    return (np.asarray(longitude, dtype=np.float64) + 180.0) % 360.0 - 180.0


def _nearest(axis: FloatArray, value: FloatArray) -> NDArray[np.intp]:
    return np.searchsorted((axis[1:] + axis[:-1]) / 2.0, value)


def _inside(axis: FloatArray, value: FloatArray) -> NDArray[np.bool_]:
    half = (axis[1] - axis[0]) / 2.0 if axis.size > 1 else 0.5
    return (value >= axis[0] - half) & (value <= axis[-1] + half)


def _within(bounds: tuple[float, float], share: FloatArray) -> FloatArray:
    return bounds[0] + (bounds[1] - bounds[0]) * share


def _place_number(latitude_deg: FloatArray, longitude_deg: FloatArray, cell_deg: float, salt: int) -> FloatArray:
    """A number in 0..1 fixed to the cell that a point lies in (an integer hash), the same in every run."""
    row = np.floor(latitude_deg / cell_deg).astype(np.int64).astype(np.uint64)
    column = np.floor(longitude_deg / cell_deg).astype(np.int64).astype(np.uint64)
    mixed = (row * np.uint64(0x9E3779B97F4A7C15)) ^ (column * np.uint64(0xC2B2AE3D27D4EB4F)) ^ np.uint64(salt)
    mixed = (mixed ^ (mixed >> np.uint64(31))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (mixed >> np.uint64(11)).astype(np.float64) / 2.0**53


def _severity(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    """Burn severity 0..1: mostly common to a neighbourhood, partly the place's own."""
    common = _place_number(latitude_deg, longitude_deg, 0.08, 11)
    return 0.6 * common + 0.4 * _place_number(latitude_deg, longitude_deg, 0.02, 12)


def _place_roughness(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    """Factor on roughness that the coarse grid does not resolve, fixed to the place."""
    uniform = _place_number(latitude_deg, longitude_deg, 0.03, 21)
    return np.exp(PLACE_ROUGHNESS_SPREAD * np.sqrt(12.0) * (uniform - 0.5))


def _relief_loss_db(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    wide = _place_number(latitude_deg, longitude_deg, 0.15, 31)
    return _within(RELIEF_LOSS_DB, 0.5 * wide + 0.5 * _place_number(latitude_deg, longitude_deg, 0.04, 32))
