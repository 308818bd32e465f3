"""Receiver antennas: gain tables of tilted nadir beams, as configured, and the gain towards a specular point."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.access.orbits.orientation import EARTH_ROTATION_RAD_S
from shared.errors import DomainError

Array = NDArray[np.float64]

SHIPPED = Path(__file__).parent / "antennas"
TABLE_SIDE = 401  # cosines 0.005 apart: within 0.15 dB of the antennas' own tables for CYGNSS, where those bend
ACCEPTED = (
    "name, channels, floor_dbi and antennas: each with name, tilt_deg, off_boresight_deg (m, rising from 0), "
    "azimuth_deg (k, rising, below 360) and gain_dbi (m x k), or with mirror_of"
)


@dataclass(frozen=True)
class Antenna:
    """One antenna: ``tilt_deg`` from nadir towards starboard, and its gain (dBi; m, k) in its own frame.

    Angles off the boresight (m,) and azimuths about it (k,), from the flight direction towards starboard, degrees.
    """

    name: str
    tilt_deg: float
    off_boresight_deg: Array
    azimuth_deg: Array
    gain_dbi: Array

    def gain_towards(self, forward: Array, starboard: Array, nadir: Array, floor_dbi: float) -> Array:
        """Gain (dBi) along unit vectors in body components: bilinear in the table, the floor beyond it."""
        tilt = np.radians(self.tilt_deg)
        across = starboard * np.cos(tilt) - nadir * np.sin(tilt)
        along_axis = starboard * np.sin(tilt) + nadir * np.cos(tilt)
        off = np.degrees(np.arctan2(np.hypot(forward, across), along_axis))
        azimuth = np.mod(np.degrees(np.arctan2(across, forward)) - self.azimuth_deg[0], 360.0) + self.azimuth_deg[0]
        wrapped = np.append(self.azimuth_deg, self.azimuth_deg[0] + 360.0)
        gain = np.concatenate([self.gain_dbi, self.gain_dbi[:, :1]], axis=1)
        row = np.clip(np.searchsorted(self.off_boresight_deg, off, side="right") - 1, 0, len(gain) - 2)
        column = np.clip(np.searchsorted(wrapped, azimuth, side="right") - 1, 0, len(wrapped) - 2)
        down = (off - self.off_boresight_deg[row]) / (self.off_boresight_deg[row + 1] - self.off_boresight_deg[row])
        right = (azimuth - wrapped[column]) / (wrapped[column + 1] - wrapped[column])
        upper = (1 - right) * gain[row, column] + right * gain[row, column + 1]
        lower = (1 - right) * gain[row + 1, column] + right * gain[row + 1, column + 1]
        value = np.maximum((1 - down) * upper + down * lower, floor_dbi)
        return np.where(off <= self.off_boresight_deg[-1], value, floor_dbi)


@dataclass(frozen=True)
class AntennaSystem:
    """The nadir antennas of a receiver and how many delay-Doppler channels it has.

    A point is in the beams where the better antenna's gain exceeds ``floor_dbi``, below which no table goes.
    """

    name: str
    channels: int
    floor_dbi: float
    antennas: tuple[Antenna, ...]

    @cached_property
    def table(self) -> Array:
        """The better antenna's gain (n, n) over the cosines to forward and to starboard, -1..1, of what lies below."""
        cosine = np.linspace(-1.0, 1.0, TABLE_SIDE)
        forward, starboard = np.meshgrid(cosine, cosine, indexing="ij")
        rim = np.maximum(np.hypot(forward, starboard), 1.0)  # beyond the horizon: as on it, for the interpolation there
        forward, starboard = forward / rim, starboard / rim
        nadir = np.sqrt(np.maximum(1.0 - forward**2 - starboard**2, 0.0))
        each = [antenna.gain_towards(forward, starboard, nadir, self.floor_dbi) for antenna in self.antennas]
        best = np.max(each, axis=0)
        best[0, 0] = self.floor_dbi  # what looks up
        return best


@cache
def shipped_antennas(name: str = "cygnss") -> AntennaSystem:
    """An antenna system of the product's configuration."""
    return antenna_system(json.loads((SHIPPED / f"{name}.json").read_text(encoding="utf-8")))


def antenna_system(document: Any) -> AntennaSystem:
    """An antenna system from its JSON document; DomainError naming the antenna that is no antenna."""
    try:
        rows = {str(row["name"]): row for row in document["antennas"]}
        system = AntennaSystem(
            str(document["name"]),
            int(document["channels"]),
            float(document["floor_dbi"]),
            tuple(_antenna(row, rows) for row in document["antennas"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DomainError(
            f"antenna: the document does not describe an antenna system ({error!r}).",
            field="antenna",
            accepted=ACCEPTED,
        ) from error
    if not system.antennas or not 1 <= system.channels <= 64 or not np.isfinite(system.floor_dbi):
        raise DomainError("antenna: no antenna, or no channel.", field="antenna", accepted=ACCEPTED)
    return system


def _antenna(row: Mapping[str, Any], rows: Mapping[str, Mapping[str, Any]]) -> Antenna:
    source = rows[str(row["mirror_of"])] if "mirror_of" in row else row
    antenna = Antenna(
        str(row["name"]),
        float(row["tilt_deg"]),
        *(np.asarray(source[name], dtype=np.float64) for name in ("off_boresight_deg", "azimuth_deg", "gain_dbi")),
    )
    off, azimuth = antenna.off_boresight_deg, antenna.azimuth_deg
    steps = np.diff(off).min(initial=np.inf) > 0 and np.diff(azimuth).min(initial=np.inf) > 0
    ranges = len(off) > 1 and off[0] == 0 and off[-1] <= 180 and len(azimuth) > 0 and np.ptp(azimuth) < 360
    shape = antenna.gain_dbi.shape == (len(off), len(azimuth)) and bool(np.isfinite(antenna.gain_dbi).all())
    if not (steps and ranges and shape and abs(antenna.tilt_deg) <= 90):
        raise ValueError(f"the table or the tilt of antenna '{antenna.name}'")
    if "mirror_of" not in row:
        return antenna
    mirrored = np.mod(-azimuth, 360.0)  # port for starboard
    order = np.argsort(mirrored)
    return Antenna(antenna.name, antenna.tilt_deg, off, mirrored[order], antenna.gain_dbi[:, order])


def elliptical_gain_dbi(
    off_boresight_deg: Array,
    azimuth_deg: Array,
    peak_dbi: float,
    squint_deg: float,
    across_deg: float,
    along_deg: float,
) -> Array:
    """An elliptical lobe as a table (m, k): a parabola in decibels of the angles across and along the track.

    ``squint_deg``: by how much the lobe leans from the boresight towards port; widths are full widths 3 dB under the
    peak. The shipped CYGNSS table is this with 15.2 dBi, 5.8, 40.4 and 27.2 degrees: a least-squares fit to the
    starboard map that SpOCK distributes (integer dB, cells of 5 x 15 degrees, values taken at their centres).
    """
    off, azimuth = np.radians(np.asarray(off_boresight_deg)[:, np.newaxis]), np.radians(azimuth_deg)
    forward, starboard, ahead = np.sin(off) * np.cos(azimuth), np.sin(off) * np.sin(azimuth), np.cos(off) + 0 * azimuth
    squint = np.radians(-squint_deg)
    across = starboard * np.cos(squint) - ahead * np.sin(squint)
    along_axis = starboard * np.sin(squint) + ahead * np.cos(squint)
    off_axis = np.hypot(across, forward)
    scale = np.degrees(np.arctan2(off_axis, along_axis)) / np.maximum(off_axis, 1e-300)
    return np.asarray(peak_dbi - 12.0 * ((across * scale / across_deg) ** 2 + (forward * scale / along_deg) ** 2))


def body_axes(position_m: Array, velocity_m_s: Array, roll_deg: Array | None = None) -> Array:
    """Axes (n, 3, 3) of a satellite in Earth-fixed components: rows forward, starboard, nadir.

    Nadir is towards the Earth's centre; starboard is opposite the orbit's normal, taken from the inertial velocity
    (Earth-fixed velocity plus the Earth's rotation); forward completes a right-handed set. A roll (n,) turns the body
    about forward, right-handed: positive takes starboard down, so the beams move to port.
    """
    inertial = velocity_m_s + EARTH_ROTATION_RAD_S * np.stack(
        [-position_m[:, 1], position_m[:, 0], np.zeros(len(position_m))], axis=-1
    )
    nadir = -position_m / np.linalg.norm(position_m, axis=1, keepdims=True)
    normal = np.cross(position_m, inertial)
    starboard = -normal / np.linalg.norm(normal, axis=1, keepdims=True)
    forward = np.cross(starboard, nadir)
    if roll_deg is not None:
        cosine, sine = np.cos(np.radians(roll_deg))[:, np.newaxis], np.sin(np.radians(roll_deg))[:, np.newaxis]
        starboard, nadir = cosine * starboard + sine * nadir, cosine * nadir - sine * starboard
    return np.stack([forward, starboard, nadir], axis=1)
