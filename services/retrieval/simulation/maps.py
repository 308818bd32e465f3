"""Delay-Doppler maps from signal strengths: kernels placed on the map, thermal noise and speckle added."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import BOLTZMANN_J_K, WAVELENGTH_M
from services.retrieval.simulation.ambiguity import (
    COHERENT_S,
    MARGIN_DELAY,
    MARGIN_DOPPLER,
    NOMINAL,
    RAW_IF,
    MapGrid,
    covariance_roots,
)
from services.retrieval.simulation.footprint import FloatArray, Strength
from services.retrieval.simulation.scattering import coherent_kernel, diffuse_kernels, kernel_index

NOISE_TEMPERATURE_K = 550.0
NOISE_FLOOR_W = BOLTZMANN_J_K * NOISE_TEMPERATURE_K / COHERENT_S  # kTB, 7.6e-18 W
LOOK_S = {NOMINAL.mode: 0.5, RAW_IF.mode: 1.0}
EFFECTIVE_LOOKS = {NOMINAL.mode: 350.0, RAW_IF.mode: 700.0}  # of 500 and 1000 milliseconds, not all independent
LOOK_SPREAD_DB = 1.0  # what differs from look to look and is not on the map: fine terrain, antenna, transmit power.
# Real looks differ by 1.7 dB (sd) from the next one 3 km on along the track, so by at most 1.2 dB each.
CHUNK = 1024


@dataclass(frozen=True)
class Link:
    """Radio link of each look, all (n,): EIRP (W), receive gain (dBi), ranges (m), incidence, heading (deg)."""

    eirp_w: FloatArray
    rx_gain_dbi: FloatArray
    rx_range_m: FloatArray
    tx_range_m: FloatArray
    incidence_deg: FloatArray
    heading_deg: FloatArray


def coherent_power_w(link: Link, reflectivity: FloatArray) -> FloatArray:
    """Peak power of coherent reflection, EIRP G lambda^2 Gamma / ((4 pi)^2 (Rt + Rr)^2) (Gleason 2020)."""
    path = link.rx_range_m + link.tx_range_m
    return link.eirp_w * 10.0 ** (link.rx_gain_dbi / 10.0) * WAVELENGTH_M**2 * reflectivity / (4.0 * np.pi * path) ** 2


def diffuse_power_w(link: Link, reflectivity: FloatArray) -> FloatArray:
    """Factor on the diffuse kernel: EIRP G lambda^2 |R|^2 / ((4 pi)^3 Rt^2); the kernel holds 1 / Rr^2."""
    gain = 10.0 ** (link.rx_gain_dbi / 10.0)
    return link.eirp_w * gain * WAVELENGTH_M**2 * reflectivity / ((4.0 * np.pi) ** 3 * link.tx_range_m**2)


@lru_cache(maxsize=2)
def _noise_roots(grid: MapGrid) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    delay_root, doppler_root = covariance_roots(grid)
    return delay_root.astype(np.float32), doppler_root.astype(np.float32)


@lru_cache(maxsize=1)
def _coherent() -> NDArray[np.float32]:
    return coherent_kernel().astype(np.float32)


def simulate_maps(link: Link, strength: Strength, grid: MapGrid, rng: np.random.Generator) -> NDArray[np.float32]:
    """Power maps (n, delay, Doppler) in W: signal plus fluctuations, the mean noise floor removed.

    Bins may be negative, as in level-1 ``power_analog``. Fluctuations of a sum of L looks have the variance
    ((N + D)^2 + 2 C (N + D)) / L, with noise N, diffuse D and coherent C power, and the correlation of the ambiguity
    function between bins.
    """
    count = link.eirp_w.size
    spread = 10.0 ** (rng.normal(0.0, LOOK_SPREAD_DB, count) / 10.0)
    coherent = coherent_power_w(link, strength.coherent) * spread
    diffuse = diffuse_power_w(link, strength.diffuse) * spread
    kernel = kernel_index(link.incidence_deg, strength.slope_variance, link.heading_deg)
    shift_delay = rng.integers(-MARGIN_DELAY, MARGIN_DELAY + 1, count)
    shift_doppler = rng.integers(-MARGIN_DOPPLER, MARGIN_DOPPLER + 1, count)
    maps = np.empty((count, grid.delays, grid.dopplers), dtype=np.float32)
    first_delay, first_doppler = grid.first_fine_bin()
    delay_root, doppler_root = _noise_roots(grid)
    looks = EFFECTIVE_LOOKS[grid.mode]
    for start in range(0, count, CHUNK):
        part = slice(start, min(start + CHUNK, count))
        white = rng.standard_normal((part.stop - part.start, grid.delays, grid.dopplers), dtype=np.float32)
        noise = _correlate(white, delay_root, doppler_root)
        _fill(
            maps[part], noise, _coherent(), diffuse_kernels(), kernel[part],
            coherent[part] / NOISE_FLOOR_W, diffuse[part] / NOISE_FLOOR_W,
            first_delay + shift_delay[part], first_doppler + shift_doppler[part],
            grid.delay_stride, grid.doppler_stride, looks,
        )  # fmt: skip
    return maps * np.float32(NOISE_FLOOR_W)


@numba.njit(cache=True)
def _correlate(white, delay_root, doppler_root):
    """A @ W @ B.T of each map (roots are symmetric); plain loops give the same bytes whatever the number of threads."""
    count, delays, dopplers = white.shape
    result = np.zeros_like(white)
    row = np.empty(dopplers, np.float32)
    for n in range(count):
        for i in range(delays):
            row[:] = 0.0
            for k in range(delays):
                factor = delay_root[i, k]
                for j in range(dopplers):
                    row[j] += factor * white[n, k, j]
            for k in range(dopplers):
                factor = row[k]
                for j in range(dopplers):
                    result[n, i, j] += factor * doppler_root[k, j]
    return result


@numba.njit(cache=True)
def _fill(
    maps, noise, coherent_kernel, kernels, kernel, coherent, diffuse, row0, column0, row_step, column_step, looks
):
    """Power in units of the noise floor, written into ``maps``."""
    for n in range(maps.shape[0]):
        for i in range(maps.shape[1]):
            row = row0[n] + i * row_step
            for j in range(maps.shape[2]):
                column = column0[n] + j * column_step
                steady = coherent[n] * coherent_kernel[row, column]
                fading = diffuse[n] * kernels[kernel[n], row, column]
                rough = 1.0 + fading
                variance = (rough * rough + 2.0 * steady * rough) / looks
                maps[n, i, j] = steady + fading + noise[n, i, j] * np.sqrt(variance)
