"""The scanners that see fires: how their samples are spread over the swath and how large a pixel is there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EARTH_KM = 6371.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scanner:
    """A whisk-broom scanner: `pixel_m` at nadir, `scan_s` seconds a scan of `lines_per_scan` lines.

    `zone_samples` (samples from the middle of the line) and `zone_angles_deg` (scan angles there) bound the zones of
    constant angular step; `zone_merged` samples are averaged into one in each, so that the angular step grows inward.
    """

    instrument: str
    samples: int
    pixel_m: float
    lines_per_scan: int
    scan_s: float
    altitude_km: float
    inclination_deg: float
    zone_samples: tuple[float, ...]
    zone_angles_deg: tuple[float, ...]

    def angle_rad(self, sample: NDArray[np.generic]) -> Floats:
        """Scan angle of pixel centres (n,) by sample, signed: negative before the middle of the line."""
        off = np.asarray(sample, float) + 0.5 - self.samples / 2
        angle = np.interp(np.abs(off), self.zone_samples, self.zone_angles_deg)
        return np.asarray(np.radians(np.sign(off) * angle))

    def footprint_m(self, sample: NDArray[np.generic]) -> tuple[Floats, Floats]:
        """(along, across) size in m of pixels (n,) by sample, on a spherical Earth.

        Along track a pixel grows with the slant range, across track also with the obliquity of the ground (Giglio et
        al. 2018, MODIS Collection 6 User's Guide, section 4.3.1, for MODIS).
        """
        off = np.minimum(np.abs(np.asarray(sample, float) + 0.5 - self.samples / 2), self.zone_samples[-1] - 0.5)
        angle = np.radians(np.interp(off, self.zone_samples, self.zone_angles_deg))
        zone = np.clip(np.searchsorted(self.zone_samples, off, side="right") - 1, 0, len(self.zone_samples) - 2)
        step = np.radians(np.diff(self.zone_angles_deg) / np.diff(self.zone_samples))[zone]
        ratio = (EARTH_KM + self.altitude_km) / EARTH_KM
        local = np.arcsin(ratio * np.sin(angle))
        across = EARTH_KM * 1e3 * (ratio * np.cos(angle) / np.cos(local) - 1.0) * step
        slant = EARTH_KM * (ratio * np.cos(angle) - np.cos(local))
        return self.pixel_m * slant / self.altitude_km, across


_VIIRS_ANGLES = (0.0, 31.72, 44.86, 56.28)
# VIIRS merges three, two and one samples from nadir outward (VIIRS Geolocation ATBD); MODIS samples steadily, 1 km at
# nadir from 705 km.
VIIRS_I = Scanner("VIIRS", 6400, 375.0, 32, 1.7864, 829.0, 98.7, (0.0, 1184.0, 1920.0, 3200.0), _VIIRS_ANGLES)
VIIRS_M = Scanner("VIIRS", 3200, 750.0, 16, 1.7864, 829.0, 98.7, (0.0, 592.0, 960.0, 1600.0), _VIIRS_ANGLES)
MODIS = Scanner("MODIS", 1354, 1000.0, 10, 1.4771, 705.0, 98.2, (0.0, 677.0), (0.0, float(np.degrees(677.0 / 705.0))))

# A geostationary imager: 56 microradians from 35,786 km, seen obliquely away from its meridian.
GEOSTATIONARY_LONGITUDE_DEG = {"GOES-EAST": -75.2, "GOES-WEST": -137.2}
_GEO_HEIGHT_KM, _GEO_PIXEL_M = 35786.0, 2004.0


def geostationary_footprint_m(
    longitude_deg: Floats, latitude_deg: Floats, satellite_longitude_deg: float
) -> tuple[Floats, Floats]:
    """(longer, shorter) side in m of 2 km imager pixels at positions (n,): the view's obliquity stretches one side.

    Spherical Earth; NaN where the satellite is below the horizon.
    """
    ratio = (EARTH_KM + _GEO_HEIGHT_KM) / EARTH_KM
    cosine = np.cos(np.radians(latitude_deg)) * np.cos(np.radians(longitude_deg - satellite_longitude_deg))
    slant = np.sqrt(1.0 + ratio**2 - 2.0 * ratio * cosine)
    view = (ratio * cosine - 1.0) / slant  # cosine of the view zenith angle
    view = np.where(view > 0.02, view, np.nan)
    shorter = _GEO_PIXEL_M * slant / (ratio - 1.0)
    return shorter / view, np.where(np.isfinite(view), shorter, np.nan)
