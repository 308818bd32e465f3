"""What a nature run is about: region, period, resolution and ignitions."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Ignition:
    """One fire of a nature run: where it starts and how long after the first cut-off (negative: before it), h."""

    incident_id: str
    name: str
    longitude_deg: float
    latitude_deg: float
    start_h: float
    known_after_h: float = 2.0
    half_width_km: float = 20.0


@dataclass(frozen=True)
class Setting:
    """A nature run's frame. ``region`` is lon_min, lat_min, lon_max, lat_max in degrees; times are UTC.

    Hours ``t`` in the nature run count from ``start`` = ``first_cutoff`` minus ``pre_days``; the steps are the grid
    spacings of weather, fuels, soil and burn grid in degrees. ``wind_shift_h`` is when (h after the first cut-off)
    the wind begins to turn from ``wind_from_deg`` to ``wind_to_from_deg``.
    """

    region: tuple[float, float, float, float]
    first_cutoff: datetime
    seed: int
    cycles: int = 2
    cycle_hours: int = 24
    pre_days: int = 21
    issue_every_h: int = 6
    weather_step_deg: float = 0.25
    fuels_step_deg: float = 0.05
    soil_step_deg: float = 0.025
    burn_step_deg: float = 0.0025
    cell_m: float = 250.0
    mean_temperature_c: float = 24.0
    wet_until_days: float = 8.0
    wind_from_deg: float = 225.0
    wind_to_from_deg: float = 300.0
    wind_shift_h: float = 12.0
    mean_wind_m_s: float = 4.5
    ignitions: tuple[Ignition, ...] = ()

    @property
    def start(self) -> datetime:
        return self.first_cutoff - timedelta(days=self.pre_days)

    @property
    def cutoff_h(self) -> float:
        """Hours from ``start`` to the first cut-off."""
        return self.pre_days * 24.0

    @property
    def end_h(self) -> float:
        """Hours from ``start`` to the end of everything observed."""
        return self.cutoff_h + self.cycles * self.cycle_hours

    @property
    def centre(self) -> tuple[float, float]:
        west, south, east, north = self.region
        return (west + east) / 2, (south + north) / 2

    @property
    def utm_epsg(self) -> int:
        """EPSG code of the WGS 84 / UTM zone (northern hemisphere) of the region's centre."""
        return 32600 + int((self.centre[0] + 180) // 6) + 1

    def generator(self, name: str) -> np.random.Generator:
        """A random stream of its own for each part, so that changing one part leaves the others as they were."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])

    def axes(self, step_deg: float) -> tuple[FloatArray, FloatArray]:
        """Longitudes and latitudes, ascending, covering the region, at the given spacing in degrees."""
        west, south, east, north = self.region
        across = np.round(west + step_deg * np.arange(round((east - west) / step_deg) + 1), 6)
        up = np.round(south + step_deg * np.arange(round((north - south) / step_deg) + 1), 6)
        return across, up

    def mesh(self, step_deg: float) -> tuple[FloatArray, FloatArray]:
        """Longitude and latitude of every node, shape (latitude, longitude), degrees."""
        longitude, latitude = self.axes(step_deg)
        across, up = np.meshgrid(longitude, latitude)
        return across, up

    def time(self, hours: float) -> datetime:
        """The UTC time so many hours after ``start``, to the second."""
        return self.start + timedelta(seconds=round(hours * 3600))

    def times(self, hours: FloatArray) -> NDArray[np.datetime64]:
        """UTC times (naive datetime64[ns], as netCDF wants them) so many hours after ``start``."""
        origin = np.datetime64(self.start.replace(tzinfo=None), "ns")
        seconds = np.round(np.asarray(hours) * 3600).astype("timedelta64[s]")
        return (origin + seconds).astype("datetime64[ns]")
