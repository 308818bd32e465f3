"""Smooth random fields on a rectangle as sums of cosines, and a clock that runs by day and rests by night."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

BINS = 96


@dataclass(frozen=True)
class CosineField:
    """A Gaussian field of unit variance with Matern covariance: `along_y` (rows, p), `along_x` (columns, q) cosines
    and the standard deviation (p, q) of each product's amplitude.

    Cosines are the eigenfunctions of the covariance on a rectangle with reflecting edges; the amplitudes follow the
    Matern spectral density (Rasmussen & Williams 2006, eq. 4.15). White numbers (members, p, q) give smooth fields.
    """

    along_y: Tensor
    along_x: Tensor
    amplitude: Tensor

    def __call__(self, white: Tensor) -> Tensor:
        """Fields (members, rows * columns) of white amplitudes (members, p, q)."""
        field = self.along_y @ (self.amplitude * white) @ self.along_x.T
        return field.reshape(white.shape[0], -1)


def _cosines(count: int, cell_km: float, shortest_km: float) -> tuple[np.ndarray, np.ndarray]:
    order = np.arange(count)
    wavenumber = np.pi * order / (count * cell_km)
    kept = max(int((wavenumber <= 2 * np.pi / shortest_km).sum()), 3)
    modes = np.cos(np.pi * np.outer((np.arange(count) + 0.5) / count, order[:kept]))
    modes[:, 1:] *= math.sqrt(2)
    return modes, wavenumber[:kept]


def cosine_field(rows: int, columns: int, cell_km: float, length_km: float, smoothness: float = 1.0) -> CosineField:
    """The Matern field of a correlation length and smoothness (the order nu) on rows x columns cells of `cell_km`."""
    along_y, k_y = _cosines(rows, cell_km, length_km / 1.2)
    along_x, k_x = _cosines(columns, cell_km, length_km / 1.2)
    squared = k_y[:, None] ** 2 + k_x[None] ** 2
    density = (1 + length_km**2 / (2 * smoothness) * squared) ** -(smoothness + 1)
    amplitude = np.sqrt(density / density.sum())
    return CosineField(*(torch.tensor(a, dtype=torch.float32) for a in (along_y, along_x, amplitude)))


def daily(steady_h: Tensor, coefficients: Tensor) -> Tensor:
    """Hours on the wall clock (members, n) of arrivals at a steady pace; `coefficients` (members, 2).

    The wall clock runs exp(a sin + b cos) times as fast as the steady one over 24 h, normalised so that a day is a
    day: fires run by day and rest by night. Always increasing; without a mean shift.
    """
    phase = (torch.arange(BINS) + 0.5) / BINS * 2 * math.pi
    rate = torch.exp(coefficients @ torch.stack([torch.sin(phase), torch.cos(phase)]))
    step = rate / rate.mean(dim=1, keepdim=True) * (24.0 / BINS)
    edges = torch.cat([torch.zeros(step.shape[0], 1), torch.cumsum(step, dim=1)], dim=1)
    edges = edges - (edges[:, :-1] - torch.arange(BINS) * (24.0 / BINS)).mean(dim=1, keepdim=True)
    day = torch.floor(steady_h / 24.0)
    position = (steady_h - 24.0 * day) / (24.0 / BINS)
    bin_ = position.detach().long().clamp(0, BINS - 1)
    return 24.0 * day + edges.gather(1, bin_) + (position - bin_) * step.gather(1, bin_)
