"""Woodward ambiguity function of the C/A code, and the delay-Doppler grids that maps are sampled on.

Both modes live on one fine grid: a delay step of one raw-IF sample (0.0638 chip) and a Doppler step of 50 Hz. The
raw-IF map is 69 x 111 of it; the nominal map takes every 4th delay (0.2552 chip) and every 10th Doppler (500 Hz), 17
x 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import CODE_RATE_HZ, SAMPLING_HZ

FloatArray = NDArray[np.float64]

COHERENT_S = 1e-3
FINE_DELAY_CHIPS = CODE_RATE_HZ / SAMPLING_HZ
FINE_DOPPLER_HZ = 50.0
MARGIN_DELAY, MARGIN_DOPPLER = 2, 5  # the specular point may sit half a nominal bin off the centre


@dataclass(frozen=True)
class MapGrid:
    """Shape and steps of a map; steps count fine bins."""

    mode: str
    delays: int
    dopplers: int
    delay_stride: int
    doppler_stride: int

    @property
    def delay_resolution_chips(self) -> float:
        return self.delay_stride * FINE_DELAY_CHIPS

    @property
    def doppler_resolution_hz(self) -> float:
        return self.doppler_stride * FINE_DOPPLER_HZ

    def first_fine_bin(self) -> tuple[int, int]:
        """Fine-grid index (delay, Doppler) of this map's first bin when the specular point is centred."""
        return (
            FINE_DELAYS // 2 - (self.delays // 2) * self.delay_stride,
            FINE_DOPPLERS // 2 - (self.dopplers // 2) * self.doppler_stride,
        )


NOMINAL = MapGrid("nominal", 17, 11, 4, 10)
RAW_IF = MapGrid("raw-if", 69, 111, 1, 1)
FINE_DELAYS = RAW_IF.delays + 2 * MARGIN_DELAY
FINE_DOPPLERS = RAW_IF.dopplers + 2 * MARGIN_DOPPLER


def delay_response(delay_chips: FloatArray) -> FloatArray:
    """Squared code autocorrelation: triangle of one chip half-width, squared."""
    return np.maximum(1.0 - np.abs(delay_chips), 0.0) ** 2


def doppler_response(doppler_hz: FloatArray, coherent_s: float = COHERENT_S) -> FloatArray:
    """Squared Doppler response sin(pi f T)^2 / (pi f T)^2 of a coherent sum of ``coherent_s`` seconds."""
    return np.sinc(np.asarray(doppler_hz) * coherent_s) ** 2


def ambiguity(delay_chips: FloatArray, doppler_hz: FloatArray, coherent_s: float = COHERENT_S) -> FloatArray:
    """Squared Woodward ambiguity function chi^2 (Zavorotny and Voronovich 2000, eq. 20), broadcast over its inputs."""
    return delay_response(delay_chips) * doppler_response(doppler_hz, coherent_s)


def fine_axes() -> tuple[FloatArray, FloatArray]:
    """Delay (chips) and Doppler (Hz) of the fine grid's bins, zero at the specular point."""
    delay = (np.arange(FINE_DELAYS) - FINE_DELAYS // 2) * FINE_DELAY_CHIPS
    doppler = (np.arange(FINE_DOPPLERS) - FINE_DOPPLERS // 2) * FINE_DOPPLER_HZ
    return delay, doppler


def covariance_roots(grid: MapGrid) -> tuple[FloatArray, FloatArray]:
    """Square roots of the separable speckle covariance chi^2(lag) along delay and along Doppler.

    Neighbouring bins see the same code chips and the same millisecond, so noise and speckle are correlated as the
    ambiguity function is; white noise W becomes A @ W @ B.T with (A, B) returned here.
    """
    delay_lag = np.subtract.outer(np.arange(grid.delays), np.arange(grid.delays)) * grid.delay_resolution_chips
    doppler_lag = np.subtract.outer(np.arange(grid.dopplers), np.arange(grid.dopplers)) * grid.doppler_resolution_hz
    return _symmetric_root(delay_response(delay_lag)), _symmetric_root(doppler_response(doppler_lag))


def _symmetric_root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
