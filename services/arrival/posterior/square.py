"""The square of cells, scaled to the fire, on which its arrival is corrected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from services.arrival.looks import Looks

CELLS = 80
FINEST_KM = 0.08
MARGIN_KM = 2.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Square:
    """Local km of the cell centres: `x_km` columns and `y_km` rows, both (CELLS,), `cell_km` apart."""

    x_km: Floats
    y_km: Floats
    cell_km: float

    def centres(self) -> tuple[Floats, Floats]:
        """Local (x, y) of every cell, two (rows, columns) arrays in km."""
        x, y = np.meshgrid(self.x_km, self.y_km)
        return x, y

    def index(self, x_km: Floats, y_km: Floats) -> Floats:
        """Fractional (row, column) of points (n,); (2, n)."""
        rows, columns = (np.ravel(y_km) - self.y_km[0]) / self.cell_km, (np.ravel(x_km) - self.x_km[0]) / self.cell_km
        return np.stack([rows, columns])

    def blurred(self, values: Floats, sigma_km: float) -> Floats:
        """A raster (rows, columns) under a Gaussian of `sigma_km`."""
        return np.asarray(gaussian_filter(values, sigma_km / self.cell_km, mode="nearest", truncate=3.0))


def square_around(fire: Looks) -> Square:
    """The square around the sightings (at least one) with a margin of 2 km."""
    spans = [(v.min() - MARGIN_KM, v.max() + MARGIN_KM) for v in (fire.x_km, fire.y_km)]
    cell_km = max(max(high - low for low, high in spans) / CELLS, FINEST_KM)
    steps = cell_km * (np.arange(CELLS) - 0.5 * (CELLS - 1))
    x, y = (0.5 * (low + high) + steps for low, high in spans)
    return Square(x, y, cell_km)
