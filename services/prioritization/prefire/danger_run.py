"""A whole pre-fire rating: from fuels, weather and what was seen to the danger grid, rasters and counts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from services.prioritization.prefire import conditions, danger, danger_grid, danger_product, danger_rasters, fuels
from services.prioritization.prefire.danger_product import DIMENSIONS, Rates, Tally
from shared.contracts import grids
from shared.errors import DomainError

_OWN = ("fuels",)


@dataclass(frozen=True)
class Rated:
    """The danger grid of the contract, the 1 km rasters where that grid was asked for, and the counts."""

    grid: xr.Dataset
    tally: Tally
    stack: danger_rasters.RasterStack | None


def read_fuels(path: Path) -> fuels.Fuels:
    """Fuels from netCDF (latitude-longitude, or metres on the USGS grid) or from a GeoTIFF on the USGS grid."""
    with path.open("rb") as stream:
        start = stream.read(4)
    if start[:2] in (b"II", b"MM"):
        return fuels.read_geotiff(str(path))
    return fuels.fuels_from_dataset(grids.read_netcdf(path))


def on_grid(given: fuels.Fuels, wanted: str) -> danger.FuelsSource:
    """The fuels on the grid wanted: ``fuels`` (their own), ``usgs-1km`` (whole) or ``usgs-1km-window`` around them.

    Fuels that lie on the USGS grid stay on their own cells. DomainError where fuels and grid do not meet.
    """
    if wanted in _OWN or isinstance(given.grid, danger_grid.UsgsGrid):
        return given
    window = danger_grid.usgs_window(*np.broadcast_arrays(*given.grid.corners()))
    whole = danger_grid.UsgsGrid()
    return fuels.SampledFuels(fuels.single_precision(given), window if wanted == "usgs-1km-window" else whole)


def rate(
    source: danger.FuelsSource,
    daily: conditions.DailyConditions,
    seen: danger.SeenLand,
    time: pd.Timestamp,
    version: danger.FpiVersion = "2000",
    effects: danger.DangerEffects | None = None,
    products: Collection[str] = ("wfpi", "wlfp", "wfsp", "change"),
) -> Rated:
    """Rate a grid. On the USGS grid ``products`` become rasters and the danger grid holds their means over 0.1 degrees.

    DomainError where the weather reaches none of the burnable cells.
    """
    effects = effects or danger.DangerEffects()
    tally = Tally(daily.days)
    parts = _rated_blocks(source, daily, seen, time, version, effects, tally)
    notes = {"fpi_version": version, "fire_probability": effects.probability.trained_on}
    if isinstance(source.grid, danger_grid.GeographicGrid):
        dataset = danger_product.geographic_dataset(source.grid, parts, time, notes)
        _check_weather(tally)
        return Rated(dataset, tally, None)
    stack = danger_rasters.empty_stack(source.grid, daily.days, products)
    coarse = danger_rasters.Coarse(source.grid, daily.days)
    for part in parts:
        stack.add(part)
        coarse.add(part)
    _check_weather(tally)
    return Rated(_coarse_dataset(coarse, time, notes), tally, stack)


def _rated_blocks(
    source: danger.FuelsSource,
    daily: conditions.DailyConditions,
    seen: danger.SeenLand,
    time: pd.Timestamp,
    version: danger.FpiVersion,
    effects: danger.DangerEffects,
    tally: Tally,
) -> Iterator[Rates]:
    for block in danger.blocks(source, daily, seen, time, version, effects):
        part = danger_product.rates(block, time, effects.probability)
        tally.add(block, part.layers)
        yield part


def _check_weather(tally: Tally) -> None:
    if tally.cells and not tally.known.any():
        raise DomainError(
            "The weather reaches no burnable cell of the fuels grid on any lead day.",
            field="weather",
            accepted="hourly weather over the fuels grid, after the time",
        )


def _coarse_dataset(coarse: danger_rasters.Coarse, time: pd.Timestamp, notes: dict[str, Any]) -> xr.Dataset:
    means, mask = coarse.layers()
    grid = coarse.grid()
    data: dict[str, Any] = {
        name: (DIMENSIONS, values, danger_product.layer_attributes(name)) for name, values in means.items()
    }
    data["mask_code"] = (("latitude", "longitude"), mask, danger_product.mask_attributes())
    days = len(next(iter(means.values())))
    notes = {**notes, "comment": "means of the burnable 1 km cells in each 0.1 degree cell"}
    return xr.Dataset(
        data,
        coords=danger_product.coordinates(grid, time, days),
        attrs=danger_product.global_attributes(time, notes),
    )


def write_rasters(rated: Rated, new_file: Callable[[str], Path], attributes: dict[str, Any]) -> list[str]:
    """Write the rasters of a 1 km grid, or one raster of WFPI and WFPI-x codes of a latitude-longitude grid; names."""
    if rated.stack is not None:
        return list(rated.stack.write(new_file, attributes))
    danger_rasters.write_geographic(rated.grid, new_file("danger.tif"), attributes)
    return ["danger.tif"]
