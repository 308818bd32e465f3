"""Soil permittivity and circular-polarisation Fresnel reflectivity at L band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import GPS_L1_HZ

VACUUM_PERMITTIVITY_F_M = 8.854187e-12
INFINITE_FREQUENCY_PERMITTIVITY = 4.9
FRESH_WATER_PERMITTIVITY = 79.0 + 6.0j  # about 20 C at L band

FloatArray = NDArray[np.float64]


def _refraction(permittivity: FloatArray, loss: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Refractive index n and normalised attenuation k of permittivity + i loss (Mironov 2009, eq. 14, 15)."""
    modulus = np.hypot(permittivity, loss)
    return np.sqrt((modulus + permittivity) / 2.0), np.sqrt((modulus - permittivity) / 2.0)


def _debye(static: FloatArray, relaxation_s: FloatArray, conductivity_s_m: FloatArray, frequency_hz: float):
    """Permittivity and loss of one water component (Debye with ohmic loss; Mironov 2009, eq. 16)."""
    omega_tau = 2.0 * np.pi * frequency_hz * relaxation_s
    strength = (static - INFINITE_FREQUENCY_PERMITTIVITY) / (1.0 + omega_tau**2)
    ohmic = conductivity_s_m / (2.0 * np.pi * frequency_hz * VACUUM_PERMITTIVITY_F_M)
    return INFINITE_FREQUENCY_PERMITTIVITY + strength, strength * omega_tau + ohmic


def soil_permittivity(soil_moisture: FloatArray, clay_fraction: FloatArray, frequency_hz: float = GPS_L1_HZ):
    """Complex relative permittivity of moist soil, any shape.

    ``soil_moisture`` in m3/m3, ``clay_fraction`` in 0..1. Mineralogy-based spectroscopic dielectric model of Mironov,
    Kosolapova and Fomin, IEEE TGRS 47 (2009), eq. 11-25.
    """
    moisture = np.asarray(soil_moisture, dtype=np.float64)
    clay = np.asarray(clay_fraction, dtype=np.float64)
    n_dry = 1.634 - 0.539 * clay + 0.2748 * clay**2
    k_dry = 0.03952 - 0.04038 * clay
    bound_limit = 0.02863 + 0.30673 * clay
    n_bound, k_bound = _refraction(
        *_debye(79.8 - 85.4 * clay + 32.7 * clay**2, 1.062e-11 + 3.45e-12 * clay, 0.3112 + 0.467 * clay, frequency_hz)
    )
    free = np.full_like(clay, 100.0), np.full_like(clay, 8.5e-12)
    n_free, k_free = _refraction(*_debye(*free, 0.3631 + 1.217 * clay, frequency_hz))
    bound = np.minimum(moisture, bound_limit)
    loose = np.maximum(moisture - bound_limit, 0.0)
    n = n_dry + (n_bound - 1.0) * bound + (n_free - 1.0) * loose
    k = k_dry + k_bound * bound + k_free * loose
    return (n**2 - k**2) + 2j * n * k


def reflectivity_rhcp_to_lhcp(permittivity: NDArray[np.complex128], incidence_deg: FloatArray) -> FloatArray:
    """Power reflectivity |(Rvv - Rhh) / 2|^2 of a smooth surface, right- to left-hand circular, any shape."""
    theta = np.deg2rad(np.asarray(incidence_deg, dtype=np.float64))
    cosine = np.cos(theta)
    root = np.sqrt(permittivity - np.sin(theta) ** 2)
    vertical = (permittivity * cosine - root) / (permittivity * cosine + root)
    horizontal = (cosine - root) / (cosine + root)
    return np.abs((vertical - horizontal) / 2.0) ** 2


def soil_reflectivity(soil_moisture: FloatArray, clay_fraction: FloatArray, incidence_deg: FloatArray) -> FloatArray:
    """Smooth-surface reflectivity of moist soil (5/15/30/45 % moisture, clay 0.2, 30 deg: -10.3/-6.7/-4.4/-3.3 dB)."""
    return reflectivity_rhcp_to_lhcp(soil_permittivity(soil_moisture, clay_fraction), incidence_deg)


def water_reflectivity(incidence_deg: FloatArray) -> FloatArray:
    """Smooth-surface reflectivity of calm fresh water."""
    return reflectivity_rhcp_to_lhcp(np.complex128(FRESH_WATER_PERMITTIVITY), incidence_deg)
