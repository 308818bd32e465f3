"""Contacts: when a satellite stands above a ground station's mask, seen along the ellipsoid's normal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from services.access.ellipsoid import SEMI_MAJOR_M, to_cartesian, to_geodetic, up_vector
from services.access.events.azimuth_mask import AzimuthMask
from services.access.events.crossings import maximum_in, positive_intervals
from services.access.orbits.ephemeris import Ephemeris
from shared.errors import DomainError

Array = NDArray[np.float64]

HORIZON_STEP_S = 0.5


@dataclass(frozen=True)
class Station:
    """A ground station; ``datum`` says whether latitude and height are ``geodetic`` (WGS84) or ``spherical``.

    Spherical: geocentric latitude, and height above a sphere of the equatorial radius (GMAT's StateType = Spherical).
    ``up``: elevations count from the plane normal to the ellipsoid's normal (``geodetic``) or to the direction from the
    Earth's centre (``spherical``). ``azimuth_mask``: a horizon over ``mask_deg``; the higher of the two holds.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    height_m: float
    mask_deg: float = 7.0
    datum: Literal["geodetic", "spherical"] = "geodetic"
    up: Literal["geodetic", "spherical"] = "geodetic"
    azimuth_mask: AzimuthMask | None = None

    def __post_init__(self) -> None:
        numbers = (self.latitude_deg, self.longitude_deg, self.height_m, self.mask_deg)
        if not np.all(np.isfinite(numbers)) or abs(self.latitude_deg) > 90.0 or not 0.0 <= self.mask_deg < 90.0:
            raise DomainError(
                f"Station {self.name}: latitude {self.latitude_deg}, longitude {self.longitude_deg}, height "
                f"{self.height_m} m and mask {self.mask_deg} do not make a station.",
                field="stations",
                value=self.name,
                accepted="latitude -90..90, mask 0..<90 degrees, finite numbers",
            )

    def position_m(self) -> Array:
        """Earth-fixed position (3,) in metres. At a pole the longitude has no effect."""
        latitude, longitude = np.float64(self.latitude_deg), np.float64(self.longitude_deg)
        if self.datum == "spherical":
            return np.asarray(up_vector(latitude, longitude) * (SEMI_MAJOR_M + self.height_m))
        return to_cartesian(latitude, longitude, self.height_m)

    def axes(self) -> Array:
        """East, north and up (3, 3) of the station's horizon. At a pole north points along its written longitude."""
        if self.up == "spherical":
            up = self.position_m() / np.linalg.norm(self.position_m())
        else:
            latitude, longitude, _ = to_geodetic(self.position_m())
            up = up_vector(latitude, longitude)
        meridian = np.radians(self.longitude_deg)
        east = np.array([-np.sin(meridian), np.cos(meridian), 0.0])
        return np.stack([east, np.cross(up, east), up])


def stations_from(rows: Iterable[Mapping[str, Any]]) -> list[Station]:
    """Stations from the rows of a stations table, longitudes 0 to 360 as -180 to 180.

    DomainError naming the row of one that makes none.
    """
    found: list[Station] = []
    for number, row in enumerate(rows):
        mask = row.get("azimuth_mask")
        try:
            found.append(
                Station(
                    row["station"],
                    row["latitude_deg"],
                    row["longitude_deg"] - 360.0 * (row["longitude_deg"] > 180.0),
                    row["height_m"],
                    row["mask_deg"],
                    row["datum"],
                    row.get("up") or "geodetic",
                    None if mask is None else AzimuthMask.parse(mask, row["station"]),
                )
            )
        except DomainError as error:
            message = f"{error.message.rstrip('.')} (row {number} of the stations)."
            raise DomainError(message, field=error.field, value=error.value, accepted=error.accepted) from error
    return found


@dataclass(frozen=True)
class Contact:
    """One pass: seconds after the ephemeris' start, and the largest elevation reached."""

    satellite: str
    station: str
    start_s: float
    end_s: float
    max_elevation_deg: float


def sine_elevation(position_m: Array, station: Station) -> Array:
    """Sine of the geometric elevation (no refraction) of Earth-fixed positions (n, 3) over the station's horizon."""
    towards = position_m - station.position_m()
    return np.asarray(towards @ station.axes()[2] / np.linalg.norm(towards, axis=-1))


def azimuth_deg(position_m: Array, station: Station) -> Array:
    """Azimuth (n,) of Earth-fixed positions (n, 3) from the station, degrees from north over east, 0 to 360."""
    east, north, _ = station.axes() @ (position_m - station.position_m()).T
    return np.asarray(np.degrees(np.arctan2(east, north)) % 360.0)


def find_contacts(ephemeris: Ephemeris, stations: Sequence[Station], end_s: float) -> list[Contact]:
    """Every interval of [0, end_s] above each station's mask, edges within 1e-6 s on the given ephemeris.

    A contact cut by the horizon's ends starts or ends there. Ordered by station as given, then time.
    """
    t_s = sample_times(ephemeris, end_s)
    samples, _ = ephemeris.states(t_s)
    found: list[Contact] = []
    for station in stations:
        above_mask = _MaskFunction(ephemeris, station, t_s, samples)
        passes = positive_intervals(above_mask, t_s)
        if station.azimuth_mask is not None:
            passes = _over_horizon(ephemeris, station, passes)
        for start, end in passes:
            peak = maximum_in(above_mask, start, end) + above_mask.sine_mask
            highest = float(np.degrees(np.arcsin(np.clip(peak, -1.0, 1.0))))
            found.append(Contact(ephemeris.name, station.name, start, end, highest))
    return found


def _over_horizon(
    ephemeris: Ephemeris, station: Station, passes: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """The parts of passes over the plain mask that are over the horizon by azimuth, too.

    That horizon has corners, so it is sampled finely; the edges lie where the elevation crosses it.
    """
    mask = station.azimuth_mask
    assert mask is not None

    def above(t_s: Array) -> Array:
        position, _ = ephemeris.states(t_s)
        elevation = np.degrees(np.arcsin(np.clip(sine_elevation(position, station), -1.0, 1.0)))
        return np.asarray(elevation - mask.elevation_deg(azimuth_deg(position, station)))

    found: list[tuple[float, float]] = []
    for start, end in passes:
        count = 3 + int((end - start) / HORIZON_STEP_S)
        found += positive_intervals(above, np.linspace(start, end, count))
    return found


def part_by_duration(contacts: Sequence[Contact], least_s: float) -> tuple[list[Contact], list[Contact]]:
    """Contacts that last at least ``least_s``, and the others; one cut by the horizon counts with what is left."""
    long = [contact for contact in contacts if contact.end_s - contact.start_s >= least_s]
    return long, [contact for contact in contacts if contact.end_s - contact.start_s < least_s]


def sample_times(ephemeris: Ephemeris, end_s: float, step_s: float = 10.0) -> Array:
    """Times from 0 to ``end_s`` at most ``step_s`` apart, the end included."""
    step = max(step_s, ephemeris.step_s) if ephemeris.step_s > step_s else step_s
    return np.unique(np.append(np.arange(0.0, end_s, step), end_s))


class _MaskFunction:
    """sin(elevation) - sin(mask) at given times; the samples all stations share are not interpolated again."""

    def __init__(self, ephemeris: Ephemeris, station: Station, t_s: Array, samples: Array) -> None:
        self._ephemeris, self._station, self._t_s, self._samples = ephemeris, station, t_s, samples
        self.sine_mask = float(np.sin(np.radians(station.mask_deg)))

    def __call__(self, t_s: Array) -> Array:
        position = self._samples if t_s is self._t_s else self._ephemeris.states(t_s)[0]
        return sine_elevation(position, self._station) - self.sine_mask
