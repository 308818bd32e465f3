"""Delay-Doppler kernels of coherent and diffuse scattering, computed once per class of geometry and slope.

A kernel is a map on the fine grid. The coherent one is the ambiguity function itself. The diffuse one integrates
sigma0(slope) over the glistening zone of a flat-Earth patch and smears it by the ambiguity function; it is normalised
so that ``Rt^2 Rr^2`` of the specular point stand outside the integral (the patch is small against either range).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import CODE_RATE_HZ, SPEED_OF_LIGHT_M_S, WAVELENGTH_M
from services.retrieval.simulation.ambiguity import (
    FINE_DELAY_CHIPS,
    FINE_DELAYS,
    FINE_DOPPLER_HZ,
    FINE_DOPPLERS,
    ambiguity,
    delay_response,
    doppler_response,
    fine_axes,
)

FloatArray = NDArray[np.float64]

INCIDENCE_CLASSES_DEG = np.arange(2.5, 70.0, 5.0)
SLOPE_VARIANCE_CLASSES = np.array([0.003, 0.006, 0.012, 0.024, 0.048, 0.1])  # mean square slope of the patch
HEADING_CLASSES_DEG = np.array([0.0, 45.0, 90.0, 135.0])  # receiver velocity against the plane of incidence
RECEIVER_HEIGHT_M = 525e3
RECEIVER_SPEED_M_S = 7590.0
TRANSMITTER_RANGE_M = 21_000e3
PATCH_HALF_WIDTH_M = 60e3
PATCH_STEP_M = 500.0


def kernel_index(incidence_deg: FloatArray, slope_variance: FloatArray, heading_deg: FloatArray) -> NDArray[np.intp]:
    """Index into ``diffuse_kernels`` of the nearest class, same shape as the inputs."""
    incidence = np.clip(np.floor(np.asarray(incidence_deg) / 5.0), 0, INCIDENCE_CLASSES_DEG.size - 1).astype(np.intp)
    edges = np.log(SLOPE_VARIANCE_CLASSES[:-1] * SLOPE_VARIANCE_CLASSES[1:]) / 2.0
    slope = np.searchsorted(edges, np.log(slope_variance))
    heading = np.round(np.mod(heading_deg, 180.0) / 45.0).astype(np.intp) % HEADING_CLASSES_DEG.size
    return (incidence * SLOPE_VARIANCE_CLASSES.size + slope) * HEADING_CLASSES_DEG.size + heading


def coherent_kernel() -> FloatArray:
    """The ambiguity function on the fine grid, 1 at the specular point."""
    delay, doppler = fine_axes()
    return ambiguity(delay[:, None], doppler[None, :])


@lru_cache(maxsize=1)
def diffuse_kernels() -> NDArray[np.float32]:
    """All diffuse kernels, (class, fine delay, fine Doppler), for |R|^2 = 1.

    Each is the integral of (q/qz)^4 exp(-tan^2 beta / mss) / mss x chi^2 dA / Rr^2 (geometric optics; Zavorotny and
    Voronovich 2000), so that the bistatic radar equation needs only the factor EIRP G lambda^2 / ((4 pi)^3 Rt^2).
    """
    kernels = [
        _diffuse_kernel(incidence, slope, heading)
        for incidence in INCIDENCE_CLASSES_DEG
        for slope in SLOPE_VARIANCE_CLASSES
        for heading in HEADING_CLASSES_DEG
    ]
    return np.stack(kernels).astype(np.float32)


@lru_cache(maxsize=64)
def _patch(incidence_deg: float, heading_deg: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Delay (chips), Doppler (Hz), tan^2(beta) and (q/qz)^4 of patch cells against the specular point; Rr there."""
    theta = np.deg2rad(incidence_deg)
    axis = np.arange(-PATCH_HALF_WIDTH_M, PATCH_HALF_WIDTH_M + 1.0, PATCH_STEP_M)
    x, y = np.meshgrid(axis, axis, indexing="ij")  # x along the plane of incidence, towards the receiver
    receiver = np.array([RECEIVER_HEIGHT_M * np.tan(theta), 0.0, RECEIVER_HEIGHT_M])
    transmitter = TRANSMITTER_RANGE_M * np.array([-np.sin(theta), 0.0, np.cos(theta)])
    ground = np.stack([x, y, np.zeros_like(x)], axis=-1)
    to_receiver, to_transmitter = receiver - ground, transmitter - ground
    receiver_range = np.linalg.norm(to_receiver, axis=-1)
    transmitter_range = np.linalg.norm(to_transmitter, axis=-1)
    specular_range = float(np.linalg.norm(receiver))
    excess_m = receiver_range + transmitter_range - specular_range - TRANSMITTER_RANGE_M
    heading = np.deg2rad(heading_deg)
    velocity = RECEIVER_SPEED_M_S * np.array([np.cos(heading), np.sin(heading), 0.0])
    closing = to_receiver @ velocity / receiver_range - receiver @ velocity / specular_range
    bisector = to_receiver / receiver_range[..., None] + to_transmitter / transmitter_range[..., None]
    slope_tangent_squared = (bisector[..., 0] ** 2 + bisector[..., 1] ** 2) / bisector[..., 2] ** 2
    tilt = (1.0 + slope_tangent_squared) ** 2
    return (
        excess_m / SPEED_OF_LIGHT_M_S * CODE_RATE_HZ,
        -closing / WAVELENGTH_M,
        slope_tangent_squared,
        tilt,
        specular_range,
    )


def _diffuse_kernel(incidence_deg: float, slope_variance: float, heading_deg: float) -> FloatArray:
    delay, doppler, tangent_squared, tilt, receiver_range_m = _patch(float(incidence_deg), float(heading_deg))
    weight = tilt * np.exp(-tangent_squared / slope_variance) / slope_variance * PATCH_STEP_M**2 / receiver_range_m**2
    reach_delay, reach_doppler = 16, 60  # the response reaches one chip and 3 kHz beyond the map
    rows = np.round(delay / FINE_DELAY_CHIPS).astype(np.intp) + FINE_DELAYS // 2 + reach_delay
    columns = np.round(doppler / FINE_DOPPLER_HZ).astype(np.intp) + FINE_DOPPLERS // 2 + reach_doppler
    shape = (FINE_DELAYS + 2 * reach_delay, FINE_DOPPLERS + 2 * reach_doppler)
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    flat = np.bincount(rows[inside] * shape[1] + columns[inside], weight[inside], shape[0] * shape[1])
    density = flat.reshape(shape)
    delay_smear = delay_response(_lags(FINE_DELAYS, shape[0], reach_delay) * FINE_DELAY_CHIPS)
    doppler_smear = doppler_response(_lags(FINE_DOPPLERS, shape[1], reach_doppler) * FINE_DOPPLER_HZ)
    return delay_smear @ density @ doppler_smear.T


def _lags(kept: int, padded: int, reach: int) -> FloatArray:
    return np.subtract.outer(np.arange(kept) + reach, np.arange(padded)).astype(np.float64)
