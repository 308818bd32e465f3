"""The danger of a 1 km grid as the USGS stores it: whole numbers with mask codes, a file for each product and lead day.

WFPI: bytes, 0-247 with masks 248-255 and the legend as colour table. WLFP and WFSP: tenths in two bytes, masks ten
times as large. Change: WFPI-x minus WFPI, rounded. All on cells of the USGS grid, so they lie on its maps as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from services.prioritization.prefire import danger_grid, fire_potential, legend
from services.prioritization.prefire.danger_product import INDICES, TARGET_STEP_DEG, Rates
from shared.contracts import cog

CHANGE_NO_DATA = -32768
_UNITS = {"wfpi": "1", "wlfp": "0.1 fires per million km2 and day", "wfsp": "0.1 percent", "change": "WFPI"}
_NAMES = ("wfpi", "wfpi_x", "wlfp", "wlfp_x", "wfsp", "wfsp_x", "wfpi_change")


@dataclass(frozen=True)
class RasterStack:
    """Whole-number layers of a 1 km grid by product name, each (lead_day, y, x)."""

    grid: danger_grid.UsgsGrid
    layers: dict[str, npt.NDArray[Any]]

    def add(self, part: Rates) -> None:
        """Put a block in its rows."""
        rows, mask = part.block.rows, part.block.fuels.mask_code
        for name, stack in self.layers.items():
            if name == "wfpi_change":
                stack[:, rows] = _change(part)
            elif name.startswith("wfpi"):
                stack[:, rows] = fire_potential.coded(part.layers[name], mask)
            else:
                stack[:, rows] = fire_potential.coded_tenths(part.layers[name], mask)

    def write(self, new_file: Callable[[str], Path], attributes: dict[str, Any]) -> Iterator[str]:
        """Each product and lead day as a Cloud-Optimised GeoTIFF such as ``wfpi_x_0.tif``; yields the names."""
        for name, stack in self.layers.items():
            for day, values in enumerate(stack):
                self._write_one(new_file(f"{name}_{day}.tif"), name, values, {**attributes, "lead_day": day})
                yield f"{name}_{day}.tif"

    def _write_one(self, path: Path, name: str, values: npt.NDArray[Any], attributes: dict[str, Any]) -> None:
        change = name == "wfpi_change"
        factor = 1 if values.dtype == np.uint8 else 10
        units = _UNITS["change" if change else name.split("_")[0]]
        cog.write_cog(
            path,
            {name: values},
            transform=self.grid.transform,
            crs=self.grid.crs,
            nodata=CHANGE_NO_DATA if change else 255 * factor,
            attributes={**attributes, "units": units, "masks": "none" if change else legend.mask_text(factor)},
            colormap=legend.colormap() if values.dtype == np.uint8 else None,
        )


def empty_stack(grid: danger_grid.UsgsGrid, days: int, products: Iterable[str]) -> RasterStack:
    """A stack for products out of wfpi, wlfp, wfsp (each with its ``_x``) and change."""
    wanted = set(products)
    names = [name for name in _NAMES if name.split("_")[0] in wanted and name != "wfpi_change"]
    names += ["wfpi_change"] if "change" in wanted else []
    kinds = {name: np.uint8 if name in ("wfpi", "wfpi_x") else np.int16 for name in names}
    return RasterStack(grid, {name: np.zeros((days, *grid.shape), dtype=kind) for name, kind in kinds.items()})


def _change(part: Rates) -> npt.NDArray[np.int16]:
    change = part.layers["wfpi_x"] - part.layers["wfpi"]
    return np.where(np.isnan(change), CHANGE_NO_DATA, np.rint(change)).astype(np.int16)


def write_geographic(grid: xr.Dataset, path: Path, attributes: dict[str, Any]) -> None:
    """WFPI and WFPI-x of every lead day of a latitude-longitude grid as one GeoTIFF of bytes, masks kept."""
    axes = danger_grid.GeographicGrid(grid["latitude"].to_numpy(), grid["longitude"].to_numpy())
    bands = {
        f"{name}_{day}": values[::-1]
        for name, codes in (("wfpi", "wfpi_code"), ("wfpi_x", "wfpi_code_x"))
        for day, values in enumerate(grid[codes].to_numpy())
    }
    stated = {**attributes, "units": _UNITS["wfpi"], "masks": legend.mask_text()}
    cog.write_cog(path, bands, transform=axes.transform, crs=axes.crs, nodata=255, attributes=stated)


class Coarse:
    """Means of a 1 km grid over even cells of latitude and longitude: the danger grid that targets are built from.

    Only burnable, known cells enter a mean; a cell without any is unknown and carries its commonest mask code.
    """

    def __init__(self, grid: danger_grid.UsgsGrid, days: int) -> None:
        self._step, self._days = TARGET_STEP_DEG, days
        west, east, south, north = _reach(grid)
        first_row, last_row = (int(np.floor((v + 90) / self._step)) for v in (south, north))
        first_column, last_column = (int(np.floor((v + 180) / self._step)) for v in (west, east))
        self._first = first_row, first_column
        self.shape = last_row - first_row + 1, last_column - first_column + 1
        size = self.shape[0] * self.shape[1]
        self._sums = {index + suffix: np.zeros((days, size)) for index in INDICES for suffix in ("", "_x")}
        self._known = np.zeros((days, size), dtype=np.int64)
        self._codes = np.zeros((9, size), dtype=np.int64)

    def add(self, part: Rates) -> None:
        """Add a block's cells to their means."""
        longitude, latitude = part.block.longitude_deg, part.block.latitude_deg
        row = np.floor((latitude + 90) / self._step).astype(np.int64) - self._first[0]
        column = np.floor((longitude + 180) / self._step).astype(np.int64) - self._first[1]
        cell = (row * self.shape[1] + column).ravel()
        size = self._known.shape[1]
        code = np.maximum(part.block.fuels.mask_code.ravel().astype(np.int64) - 247, 0)
        self._codes += np.bincount(code * size + cell, minlength=9 * size).reshape(9, size)
        for day in range(self._days):
            known = np.isfinite(part.layers["wfpi"][day]).ravel()
            inside = cell[known]
            self._known[day] += np.bincount(inside, minlength=size)
            for name, sums in self._sums.items():
                sums[day] += np.bincount(inside, part.layers[name][day].ravel()[known], minlength=size)

    def grid(self) -> danger_grid.GeographicGrid:
        """The even grid of the means."""
        axes = (
            (first + np.arange(count) + 0.5) * self._step - offset
            for first, count, offset in zip(self._first, self.shape, (90, 180), strict=True)
        )
        return danger_grid.GeographicGrid(*axes)

    def layers(self) -> tuple[dict[str, npt.NDArray[np.float32]], npt.NDArray[np.uint8]]:
        """Means by layer, each (lead_day, latitude, longitude), and the mask code of each cell."""
        full = (self._days, *self.shape)
        with np.errstate(invalid="ignore", divide="ignore"):
            means = {
                name: (sums / np.where(self._known > 0, self._known, np.nan)).astype(np.float32).reshape(full)
                for name, sums in self._sums.items()
            }
        burnable = self._codes[0] > 0
        commonest = 248 + self._codes[1:].argmax(axis=0)
        empty = self._codes.sum(axis=0) == 0
        mask = np.where(burnable, 0, np.where(empty, 249, commonest)).astype(np.uint8)
        return means, mask.reshape(self.shape)


def _reach(grid: danger_grid.UsgsGrid) -> tuple[float, float, float, float]:
    """West, east, south, north of the cells of a window, degrees (from its edge cells, and the 100 W meridian)."""
    height, _ = grid.shape
    edges = [grid.places(slice(0, 1)), grid.places(slice(height - 1, height))]
    sides = [grid.places(slice(None), slice(0, 1)), grid.places(slice(None), slice(-1, None))]
    longitude = np.concatenate([place[0].ravel() for place in (*edges, *sides)])
    latitude = np.concatenate([place[1].ravel() for place in (*edges, *sides)])
    return float(longitude.min()), float(longitude.max()), float(latitude.min()), float(latitude.max())
