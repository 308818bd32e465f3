"""Gaussian random fields that can be evaluated anywhere in space and time, so that every grid sees the same nature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from flows.cases.nature.setting import FloatArray

KM_PER_DEG = 111.195


def on_sphere_km(longitude_deg: ArrayLike, latitude_deg: ArrayLike) -> FloatArray:
    """Places as vectors (n, 3) on a sphere, km: between near ones the straight distance is that on the ground."""
    longitude, latitude = np.radians(np.asarray(longitude_deg, float)), np.radians(np.asarray(latitude_deg, float))
    flat = np.cos(latitude)
    unit = np.stack([flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)], axis=1)
    return np.asarray(unit * np.degrees(KM_PER_DEG))


@dataclass(frozen=True)
class RandomField:
    """A sum of cosines with random wave vectors: about N(0, 1), Gaussian covariance of the given length and time.

    The spectral method of Shinozuka and Deodatis (1991), Appl. Mech. Rev. 44(4). Wave vectors in rad/km and rad/h.
    """

    waves: FloatArray  # (modes, 3): east, north, time
    phases: FloatArray  # (modes,)

    def at(self, longitude_deg: ArrayLike, latitude_deg: ArrayLike, time_h: ArrayLike = 0.0) -> FloatArray:
        """The field's values; the arguments broadcast together."""
        latitude = np.asarray(latitude_deg, dtype=np.float64)
        # A fixed scale of longitude (that of 34 degrees north) keeps the phase separable in east, north and time.
        east = np.asarray(longitude_deg, dtype=np.float64) * (KM_PER_DEG * np.cos(np.radians(34.0)))
        north, time = latitude * KM_PER_DEG, np.asarray(time_h, dtype=np.float64)
        total = np.zeros(np.broadcast_shapes(east.shape, north.shape, time.shape))
        for (k_east, k_north, k_time), phase in zip(self.waves, self.phases, strict=True):
            total += np.cos(k_east * east + k_north * north + (k_time * time + phase))
        return total * np.sqrt(2.0 / len(self.phases))


def random_field(
    rng: np.random.Generator, length_km: float, *, correlation_h: float | None = None, modes: int = 40
) -> RandomField:
    """A field whose correlation is exp(-d²/2L²) over the distance d and likewise over time (constant if None)."""
    waves = np.zeros((modes, 3))
    waves[:, :2] = rng.normal(size=(modes, 2)) / length_km
    if correlation_h is not None:
        waves[:, 2] = rng.normal(size=modes) / correlation_h
    return RandomField(waves, rng.uniform(0, 2 * np.pi, modes))


def rough_field(rng: np.random.Generator, lengths_km: tuple[float, ...], modes: int = 24) -> tuple[RandomField, ...]:
    """Fields of several lengths, to be summed with weights proportional to their length (fractal relief)."""
    return tuple(random_field(rng, length, modes=modes) for length in lengths_km)


def smooth_step(value: ArrayLike, low: float, high: float) -> FloatArray:
    """0 below ``low``, 1 above ``high``, and a cubic in between."""
    s = np.clip((np.asarray(value, dtype=np.float64) - low) / (high - low), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)
