"""Fixed lattices of target places: the same place has the same id in every cycle, whatever put it there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from shared.errors import DomainError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
KM_PER_DEGREE = 111.195
KIND_CODE = {"active": 1, "prefire": 2}


@dataclass(frozen=True)
class Lattice:
    """Cells of equal height in latitude; targets stand at their centres.

    ``active``: ``spacing`` in km, columns of a row as many whole ones as fit around the parallel. ``prefire``:
    ``spacing`` in degrees both ways.
    """

    kind: Literal["active", "prefire"]
    spacing: float

    def __post_init__(self) -> None:
        low, high = (0.5, 99.0) if self.kind == "active" else (0.005, 5.0)
        if not low <= self.spacing <= high:
            unit = "km" if self.kind == "active" else "degrees"
            raise DomainError(
                f"A spacing of {self.spacing:g} {unit} is not usable.",
                field="active_spacing_km" if self.kind == "active" else "prefire_spacing_deg",
                value=self.spacing,
                accepted=f"{low:g}..{high:g} {unit}",
            )

    @property
    def height_deg(self) -> float:
        return self.spacing / KM_PER_DEGREE if self.kind == "active" else self.spacing

    @property
    def spacing_km(self) -> float:
        return self.height_deg * KM_PER_DEGREE

    def _columns(self, row: Index) -> Index:
        if self.kind == "prefire":
            return np.full(row.shape, int(np.ceil(360 / self.spacing - 1e-9)), dtype=np.int64)
        latitude = (row + 0.5) * self.height_deg - 90
        around = 360 * np.cos(np.radians(np.clip(latitude, -89.9, 89.9))) / self.height_deg
        return np.maximum(1, np.floor(around)).astype(np.int64)

    def locate(self, longitude_deg: Array, latitude_deg: Array) -> tuple[Index, Index]:
        """Row and column of the cells that hold the places."""
        row = np.floor((np.asarray(latitude_deg) + 90) / self.height_deg + 1e-9).astype(np.int64)
        columns = self._columns(row)
        width = self.height_deg if self.kind == "prefire" else 360 / columns
        column = np.floor((np.asarray(longitude_deg) + 180) / width + 1e-9).astype(np.int64)
        return row, column % columns

    def centre(self, row: Index, column: Index) -> tuple[Array, Array]:
        """Longitude and latitude (degrees) of the cells' centres."""
        width = self.height_deg if self.kind == "prefire" else 360 / self._columns(row)
        return (column + 0.5) * width - 180, (row + 0.5) * self.height_deg - 90

    def target_id(self, row: Index, column: Index) -> Index:
        """The id: kind, spacing, row and column in decimal places, so that no two places of any lattice share one."""
        spacing_code = round(self.spacing * (1000 if self.kind == "active" else 10000))
        base = KIND_CODE[self.kind] * 10**17 + spacing_code * 10**12
        return base + np.asarray(row, dtype=np.int64) * 10**6 + np.asarray(column, dtype=np.int64)
