"""A fuels grid from the MODIS NDVI of 2001: monthly NDVI between that year's extremes, with fuels guessed from them.

One year is no climatology, 10 arc minutes are no 1 km, and loads and extinction moisture follow from NDVI and trees
by a stated guess: a picture of real greenness with its date, not an operational input.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from services.prioritization.prefire import danger_grid

Array = npt.NDArray[np.floating[Any]]

MONTHLY, EXTREMES = "ndvi_2001_monthly_10min.tif", "ndvi_2001_minmax_10min.tif"
TREES = "tree_cover_10min.tif"
BARREN_NDVI = 0.12
AREA = (-130.0, 22.0, -64.0, 53.0)
YEAR = "2001"


def fuels(folder: Path, month: int) -> xr.Dataset:
    """The contract's fuels grid over North America's United States for a month (1-12) of 2001."""
    ndvi, latitude, longitude = _read(folder / MONTHLY, month)
    low, high = (_read(folder / EXTREMES, band)[0] for band in (1, 2))
    trees, _, _ = _read(folder / TREES, 1)
    water = np.isnan(ndvi) | np.isnan(low) | np.isnan(high)
    fields = {name: values / 10000 for name, values in (("ndvi", ndvi), ("ndvi_min", low), ("ndvi_max", high))}
    dataset = with_fuels(fields, latitude, longitude, water, np.nan_to_num(trees) / 100)
    dataset.attrs |= {"ndvi_date": f"{YEAR}-{month:02d}", "ndvi_years": YEAR}
    return dataset


def with_fuels(
    fields: dict[str, Array], latitude: Array, longitude: Array, water: npt.NDArray[np.bool_], trees: Any = 0.3
) -> xr.Dataset:
    """NDVI fields with guessed fuels: loads and extinction rise with greenness and trees; barren below 0.12."""
    dense = np.clip((fields["ndvi_max"] - 0.2) / 0.5, 0, 1)
    flat = np.ones_like(dense)
    values = {
        **fields,
        "live_load": 0.15 + 0.9 * dense,  # kg/m2, shrub to conifer with understorey
        "dead_load": 0.35 + 1.0 * dense + 1.0 * trees,
        "extinction_pct": 15.0 + 10.0 * np.maximum(dense * 0.5, trees),
        "soil_moisture_q05": 0.05 * flat,
        "soil_moisture_q95": 0.35 * flat,
    }
    barren = (fields["ndvi_max"] < BARREN_NDVI) | (fields["ndvi_min"] >= fields["ndvi_max"])
    mask = np.where(water, 254, np.where(barren, 252, 0)).astype(np.uint8)
    dims = ("latitude", "longitude")
    data: dict[str, Any] = {name: (dims, np.asarray(field, dtype=np.float32)) for name, field in values.items()}
    data["mask_code"] = (dims, mask)
    return xr.Dataset(data, coords={"latitude": latitude, "longitude": longitude})


def on_usgs_grid(dataset: xr.Dataset, grid: danger_grid.UsgsGrid) -> dict[str, Array]:
    """Fields (y, x) on a USGS grid by name, each from the cell that holds the centre; outside is code 249."""
    axes = danger_grid.geographic_grid(dataset["latitude"].to_numpy(), dataset["longitude"].to_numpy())
    out = {str(name): np.empty(grid.shape, dtype=np.float32) for name in dataset.data_vars}
    for first in range(0, grid.shape[0], 200):
        rows = slice(first, min(first + 200, grid.shape[0]))
        longitude, latitude = grid.places(rows)
        row, column = (
            np.floor((place - axis[0]) / step + 0.5).astype(int)
            for place, axis, step in zip(
                (latitude, longitude), (axes.latitude_deg, axes.longitude_deg), axes.steps_deg, strict=True
            )
        )
        inside = (row >= 0) & (row < axes.shape[0]) & (column >= 0) & (column < axes.shape[1])
        flat = np.where(inside, row * axes.shape[1] + column, 0)
        for name, values in out.items():
            values[rows] = dataset[name].to_numpy().ravel().take(flat)
        out["mask_code"][rows][~inside] = 249
    return out


def _read(path: Path, band: int) -> tuple[Array, Array, Array]:
    """A band over the area, rows from south to north, missing as NaN, with its axes."""
    import rasterio

    with rasterio.open(path) as source:
        values = source.read(band).astype(np.float64)
        values[values == source.nodata] = np.nan
        step = source.transform.a
        longitude = source.transform.c + step * (np.arange(source.width) + 0.5)
        latitude = source.transform.f - step * (np.arange(source.height) + 0.5)
    west, south, east, north = AREA
    columns, rows = (longitude > west) & (longitude < east), (latitude > south) & (latitude < north)
    return values[rows][::-1][:, columns], latitude[rows][::-1], longitude[columns]
