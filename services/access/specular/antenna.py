"""Receiver antennas: two nadir beams tilted to either side of the track, and the gain towards a specular point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.access.orbits.orientation import EARTH_ROTATION_RAD_S

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BeamPair:
    """Two mirrored elliptical beams; gain falls as a parabola in decibels and never below ``floor_dbi``.

    ``tilt_deg``: roll of each antenna from nadir. ``squint_deg``: by how much the lobe leans back to nadir of that.
    Widths are full widths 3 dB under the peak, across and along the track. Defaults: a least-squares fit to CYGNSS's
    starboard nadir map as SpOCK distributes it (integer dB, cells of 5 x 15 degrees, values taken at their centres):
    0.4 dB rms and 0.9 dB at most where the map says 10 dBi or more. The map itself is 0 dBi outside the lobe.
    """

    peak_dbi: float = 15.2
    tilt_deg: float = 28.0
    squint_deg: float = 5.8
    width_across_deg: float = 40.4
    width_along_deg: float = 27.2
    floor_dbi: float = 0.0

    def parameters(self) -> Array:
        """Peak and floor (dBi), lobe off nadir, widths across and along (rad): what the compiled code takes."""
        angles = np.radians([self.tilt_deg - self.squint_deg, self.width_across_deg, self.width_along_deg])
        return np.array([self.peak_dbi, self.floor_dbi, *angles])


CYGNSS_BEAMS = BeamPair()


def body_axes(position_m: Array, velocity_m_s: Array) -> Array:
    """Axes (n, 3, 3) of a nadir-pointing satellite in Earth-fixed components: rows forward, starboard, nadir.

    Nadir is towards the Earth's centre; starboard is opposite the orbit's normal, taken from the inertial velocity
    (Earth-fixed velocity plus the Earth's rotation); forward completes a right-handed set.
    """
    inertial = velocity_m_s + EARTH_ROTATION_RAD_S * np.stack(
        [-position_m[:, 1], position_m[:, 0], np.zeros(len(position_m))], axis=-1
    )
    nadir = -position_m / np.linalg.norm(position_m, axis=1, keepdims=True)
    normal = np.cross(position_m, inertial)
    starboard = -normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([np.cross(starboard, nadir), starboard, nadir], axis=1)
