"""The horizon of a station by azimuth: hills, buildings, keep-out sectors."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.errors import DomainError

Array = NDArray[np.float64]

ACCEPTED = "azimuth:elevation pairs in degrees, azimuths rising from 0 to below 360, e.g. '0:7 90:12.5 180:7 270:9'"


@dataclass(frozen=True)
class AzimuthMask:
    """Lowest elevations at azimuths (from north over east), linear between them and around through north."""

    azimuths_deg: tuple[float, ...]
    elevations_deg: tuple[float, ...]

    @classmethod
    def parse(cls, text: str, station: str) -> AzimuthMask:
        """The mask written as ``0:7 90:12.5 180:7``, parted by blanks, commas or semicolons.

        Raises DomainError naming the station and the pair at fault.
        """
        pairs = [pair for pair in re.split(r"[\s,;]+", text.strip()) if pair]
        azimuths: list[float] = []
        elevations: list[float] = []
        for pair in pairs:
            azimuth, elevation = _numbers(pair)
            rising = not azimuths or azimuth > azimuths[-1]
            if not (rising and 0.0 <= azimuth < 360.0 and 0.0 <= elevation < 90.0):
                raise DomainError(
                    f"stations: station {station}: azimuth_mask '{text}' is wrong at '{pair}'.",
                    field="azimuth_mask",
                    value=pair,
                    accepted=ACCEPTED,
                )
            azimuths.append(azimuth)
            elevations.append(elevation)
        if not pairs:
            raise DomainError(
                f"stations: station {station}: the azimuth_mask is empty.", field="azimuth_mask", accepted=ACCEPTED
            )
        return cls(tuple(azimuths), tuple(elevations))

    def elevation_deg(self, azimuth_deg: Array) -> Array:
        """The lowest elevation (n,) at azimuths (n,)."""
        return np.interp(azimuth_deg, self.azimuths_deg, self.elevations_deg, period=360.0)


def _numbers(pair: str) -> tuple[float, float]:
    azimuth, colon, elevation = pair.partition(":")
    try:
        return (float(azimuth), float(elevation)) if colon else (np.nan, np.nan)
    except ValueError:
        return np.nan, np.nan
