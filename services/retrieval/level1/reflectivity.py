"""Effective reflectivity of the surface from the peak power of a calibrated delay-Doppler map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import WAVELENGTH_M

FloatArray = NDArray[np.float64]


def reflectivity_db(
    peak_w: FloatArray, eirp_w: FloatArray, rx_gain_dbi: FloatArray, rx_range_m: FloatArray, tx_range_m: FloatArray
) -> FloatArray:
    """Gamma = (4 pi)^2 P (Rt + Rr)^2 / (EIRP G lambda^2) in dB, any one shape; NaN where the peak is not positive.

    P is the peak ``power_analog`` in W (a signal-to-noise ratio is not a power), EIRP linear in W.
    Coherent-reflection assumption: Al-Khaldi et al. 2021; Chew and Small 2020, Remote Sensing 12, 1558.
    """
    power = np.where(np.asarray(peak_w) > 0, peak_w, np.nan).astype(np.float64)
    return (
        10.0 * np.log10(power)
        - 10.0 * np.log10(eirp_w)
        - rx_gain_dbi
        - 20.0 * np.log10(WAVELENGTH_M)
        + 20.0 * np.log10(np.asarray(rx_range_m, dtype=np.float64) + tx_range_m)
        + 20.0 * np.log10(4.0 * np.pi)
    )


def footprint_m(
    incidence_deg: FloatArray, rx_range_m: FloatArray, tx_range_m: FloatArray, look_s: float
) -> tuple[FloatArray, FloatArray]:
    """Along- and across-track size (m) of a coherent look: first Fresnel zone, drawn out by the motion in ``look_s``.

    Fresnel zone 2 sqrt(lambda Rr Rt / (Rr + Rt)), along the plane of incidence / cos(incidence); the specular point
    moves at about 6.6 km/s (Camps 2019; 7.6 km/s at 525 km height, scaled to the ground).
    """
    zone = 2.0 * np.sqrt(WAVELENGTH_M * rx_range_m * tx_range_m / (rx_range_m + tx_range_m))
    return zone / np.cos(np.deg2rad(incidence_deg)) + 6600.0 * look_s, zone
