"""The danger grid as products: the contract's netCDF, the USGS's integer rasters, and what a report says of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from services.prioritization.prefire import danger_grid, fire_potential, fire_probability
from services.prioritization.prefire.danger import DangerBlock

Array = npt.NDArray[np.floating[Any]]
DIMENSIONS = ("lead_day", "latitude", "longitude")
INDICES = ("wfpi", "wlfp", "wfsp")
CHANGE_THRESHOLD = 0.5
TARGET_STEP_DEG = 0.1

_MEANING = {
    "wfpi": ("wildland fire potential index", "1"),
    "wlfp": ("expected large fires (over 500 acres) per million km2 and day", "1e-6 km-2 d-1"),
    "wfsp": ("probability that an ignited fire exceeds 500 acres", "percent"),
}
_FLAG_MEANING = "vegetation_missing vegetation_impossible weather_missing weather_hours_missing"


@dataclass(frozen=True)
class Rates:
    """WFPI, WLFP and WFSP of a block by name, with and without ``_x``, each (lead_day, y, x)."""

    block: DangerBlock
    layers: dict[str, Array]


def rates(block: DangerBlock, time: pd.Timestamp, model: fire_probability.FireProbability) -> Rates:
    """The block's probabilities; the day of the year is that of each lead day. Unchanged WFPI keeps its probability."""
    at = model.at(block.longitude_deg, block.latitude_deg)
    layers: dict[str, Array] = {"wfpi": block.wfpi, "wfpi_x": block.wfpi_x}
    for suffix in ("", "_x"):
        if suffix and block.wfpi_x is block.wfpi:
            layers |= {"wlfp_x": layers["wlfp"], "wfsp_x": layers["wfsp"]}
            continue
        for name in ("wlfp", "wfsp"):
            layers[name + suffix] = np.empty_like(block.wfpi)
        for day, values in enumerate(layers["wfpi" + suffix]):
            of_year = float((time + pd.Timedelta(days=day)).dayofyear)
            layers["wfsp" + suffix][day], layers["wlfp" + suffix][day] = at.rates(values, of_year)
    return Rates(block, layers)


@dataclass
class Tally:
    """What the report says of a grid, gathered block by block; counts are of burnable cells, by lead day."""

    days: int
    cells: int = 0
    known: npt.NDArray[np.int64] = field(init=False)
    changed: npt.NDArray[np.int64] = field(init=False)
    touched: npt.NDArray[np.int64] = field(init=False)
    flags: npt.NDArray[np.int64] = field(init=False)
    masked: npt.NDArray[np.int64] = field(init=False)
    soil_cells: int = 0
    scar_cells: int = 0
    histograms: dict[str, npt.NDArray[np.int64]] = field(default_factory=dict)
    extremes: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.known, self.changed, self.touched = (np.zeros(self.days, dtype=np.int64) for _ in range(3))
        self.flags, self.masked = np.zeros(8, dtype=np.int64), np.zeros(256, dtype=np.int64)

    def add(self, block: DangerBlock, layers: dict[str, Array]) -> None:
        """Count a block."""
        burnable = block.fuels.mask_code < 248
        self.cells += int(burnable.sum())
        self.masked += np.bincount(block.fuels.mask_code.ravel(), minlength=256)
        self.flags += [int(((block.flag[0] >> bit) & 1).sum()) for bit in range(8)]
        self.known += np.isfinite(block.wfpi).sum(axis=(1, 2))
        self.soil_cells += int(((block.seen.weight > 0) & burnable).sum())
        self.scar_cells += int(((block.seen.scar > 0) & burnable).sum())
        if block.wfpi_x is not block.wfpi:
            with np.errstate(invalid="ignore"):
                change = block.wfpi_x - block.wfpi
                self.changed += (np.abs(change) >= CHANGE_THRESHOLD).sum(axis=(1, 2))
                self.touched += (np.abs(change) > 0).sum(axis=(1, 2))
            self._widen("change", change)
        for name, values in layers.items():
            self._widen(name, values)
            tenths = np.clip(values[np.isfinite(values)] * 10, 0, 9999).astype(np.int32)
            self.histograms[name] = self.histograms.get(name, 0) + np.bincount(tenths, minlength=10000)

    def _widen(self, name: str, values: Array) -> None:
        finite = values[np.isfinite(values)]
        if len(finite):
            low, high = self.extremes.get(name, (np.inf, -np.inf))
            self.extremes[name] = min(low, float(finite.min())), max(high, float(finite.max()))

    def report(self) -> dict[str, Any]:
        """Ranges by layer, what lacks weather or vegetation, how much the satellites changed."""
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(self.known > 0, self.changed / np.maximum(self.known, 1), 0.0)
            touched = np.where(self.known > 0, self.touched / np.maximum(self.known, 1), 0.0)
        low, high = self.extremes.get("change", (0.0, 0.0))
        names = _FLAG_MEANING.split()
        return {
            "layers": {name: self._range(name) for name in self.histograms},
            "burnable_cells": self.cells,
            "lead_days_without_weather": [day for day in range(self.days) if self.cells and not self.known[day]],
            "burnable_cells_unknown_on_day_0": int(self.cells - self.known[0]),
            "flagged_cells_on_day_0": {name: int(self.flags[bit]) for bit, name in enumerate(names)},
            "share_changed_by_satellites": float(share[0]),
            "share_changed_by_satellites_by_lead_day": [float(value) for value in share],
            "share_touched_by_satellites": float(touched[0]),
            "change_counts_from": CHANGE_THRESHOLD,
            "wfpi_change_largest": high,
            "wfpi_change_smallest": low,
            "soil_moisture_cells_used": self.soil_cells,
            "burn_scar_cells": self.scar_cells,
            "masked_cells": {str(code): int(self.masked[code]) for code in fire_potential.MASK_CODES},
        }

    def _range(self, name: str) -> dict[str, float | None]:
        """Minimum, median, 95 % quantile and maximum; the middle two to a tenth."""
        if name not in self.extremes:
            return dict.fromkeys(("minimum", "median", "q95", "maximum"), None)
        rising = np.cumsum(self.histograms[name])
        middle, high = (float(np.searchsorted(rising, q * rising[-1])) / 10 for q in (0.5, 0.95))
        least, largest = self.extremes[name]
        return {"minimum": least, "median": middle, "q95": high, "maximum": largest}


def geographic_dataset(
    grid: danger_grid.GeographicGrid, parts: Iterable[Rates], time: pd.Timestamp, attributes: dict[str, Any]
) -> xr.Dataset:
    """The danger grid of the contract from the blocks of a latitude-longitude grid."""
    held = list(parts)
    data: dict[str, Any] = {}
    for suffix in ("", "_x"):
        for index in INDICES:
            values = np.concatenate([part.layers[index + suffix] for part in held], axis=1)
            data[index + suffix] = (DIMENSIONS, values.astype(np.float32), layer_attributes(index + suffix))
            if index == "wfpi":
                codes = np.concatenate(
                    [fire_potential.coded(part.layers["wfpi" + suffix], part.block.fuels.mask_code) for part in held], 1
                )
                data["wfpi_code" + suffix] = (DIMENSIONS, codes, {"long_name": "WFPI as USGS code, 248-255 masks"})
    flags = np.concatenate([part.block.flag for part in held], axis=1)
    bits = np.array([1, 2, 4, 8], dtype=np.uint8)
    data["quality_flag"] = (DIMENSIONS, flags, {"flag_masks": bits, "flag_meanings": _FLAG_MEANING})
    data |= _land_layers(held)
    return xr.Dataset(data, coords=coordinates(grid, time, len(flags)), attrs=global_attributes(time, attributes))


def layer_attributes(name: str) -> dict[str, str]:
    """Meaning and units of a layer by its name, such as ``wfsp_x``."""
    index, _, seen = name.partition("_")
    meaning, units = _MEANING[index]
    return {"long_name": meaning + (", with soil moisture and burned area" if seen else ""), "units": units}


def mask_attributes() -> dict[str, Any]:
    """What the mask codes mean, for netCDF."""
    return {
        "long_name": "mask code, 0 where burnable",
        "flag_values": np.array([0, *sorted(fire_potential.MASK_CODES)], dtype=np.uint8),
        "flag_meanings": "burnable outside_a outside_b snow_or_ice agriculture barren marsh water no_data",
    }


def _land_layers(parts: list[Rates]) -> dict[str, Any]:
    flat = ("latitude", "longitude")
    mask = np.concatenate([part.block.fuels.mask_code for part in parts])
    seen = [part.block.seen for part in parts]
    weight, position, scar = (
        np.concatenate([getattr(block, name) for block in seen]).astype(np.float32)
        for name in ("weight", "position", "scar")
    )
    return {
        "mask_code": (flat, mask, mask_attributes()),
        "soil_moisture_weight": (flat, weight, {"units": "1"}),
        "soil_moisture_position": (flat, position, {"units": "1"}),
        "burn_scar": (flat, scar, {"long_name": "share of fuel lost to scars", "units": "1"}),
    }


def coordinates(grid: danger_grid.GeographicGrid, time: pd.Timestamp, days: int) -> dict[str, Any]:
    """Lead days with their starts, latitude and longitude."""
    starts = pd.date_range(time.tz_convert("UTC").tz_localize(None), periods=days, freq="D")
    return {
        "lead_day": ("lead_day", np.arange(days, dtype=np.int32), {"long_name": "lead day, 24 h from its start"}),
        "latitude": ("latitude", grid.latitude_deg, {"units": "degrees_north", "standard_name": "latitude"}),
        "longitude": ("longitude", grid.longitude_deg, {"units": "degrees_east", "standard_name": "longitude"}),
        "lead_day_start": ("lead_day", starts.to_numpy()),
    }


def global_attributes(time: pd.Timestamp, attributes: dict[str, Any]) -> dict[str, Any]:
    """Title and validity, with what else is stated of the run."""
    return {
        "title": "Pre-fire danger: WFPI, WLFP, WFSP and the same with soil moisture and burned area",
        "valid_from": time.tz_convert("UTC").strftime("%Y-%m-%dT%H:%M:%SZ"),
        **attributes,
    }
