"""What leaves the soil-moisture retrieval: the level-3 grid, as CF netCDF and COG."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from services.retrieval.constants import FILL
from services.retrieval.ease_grid import EASE_CRS, cell_coordinates, corner_transform, ease_grid
from shared.contracts.cog import write_cog


def level3_grid(table: pd.DataFrame, resolution_km: int = 9) -> xr.Dataset:
    """Daily soil moisture on EASE-Grid 2.0 (9 or 36 km): ``SM_daily``, ``SIGMA_daily``, ``count`` (time, y, x).

    The grid covers the box of the table's cells (one empty cell without any). Modes of a day and cell are joined with
    inverse-variance weights. Named as in the UCAR/CU level-3 product.
    """
    rows = _span(table["row"])
    columns = _span(table["column"])
    days = pd.to_datetime(table["time"], utc=True).dt.tz_localize(None).to_numpy().astype("datetime64[D]")
    known_days = np.unique(days) if len(days) else np.array(["1970-01-01"], dtype="datetime64[D]")
    shape = (known_days.size, rows.size, columns.size)
    weight, total, count = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.int32)
    if len(table):
        cell = table["row"].to_numpy() - rows[0], table["column"].to_numpy() - columns[0]
        place = (np.searchsorted(known_days, days), *cell)
        share = 1.0 / np.maximum(table["soil_moisture_sd"].to_numpy(), 1e-3) ** 2
        np.add.at(weight, place, share)
        np.add.at(total, place, share * table["soil_moisture"].to_numpy())
        np.add.at(count, place, table["count"].to_numpy())
    seen = weight > 0
    safe = np.where(seen, weight, 1.0)
    values = {
        "SM_daily": (np.where(seen, total / safe, FILL), "volumetric soil moisture, m3 m-3"),
        "SIGMA_daily": (np.where(seen, 1.0 / np.sqrt(safe), FILL), "standard deviation of SM_daily, m3 m-3"),
    }
    return _level3_dataset(values, count, known_days, rows, columns, resolution_km)


def _span(index: pd.Series) -> NDArray[np.int64]:
    return np.arange(index.min(), index.max() + 1) if len(index) else np.array([0])


def _level3_dataset(values, count, days, rows, columns, resolution_km: int) -> xr.Dataset:
    dims = ("time", "y", "x")
    common = {"units": "1", "grid_mapping": "crs"}
    fill = {"_FillValue": np.float32(FILL)}
    dataset = xr.Dataset(
        {
            name: (dims, data.astype(np.float32), {**common, **fill, "long_name": text})
            for name, (data, text) in values.items()
        },
        coords={
            "time": ("time", days.astype("datetime64[ns]"), {"standard_name": "time", "long_name": "UTC day"}),
            **cell_coordinates(rows, columns, resolution_km),
        },
        attrs={
            "title": f"Soil moisture from GNSS reflectivity, daily, EASE-Grid 2.0 {resolution_km} km",
            "grid": ease_grid(resolution_km).name,
            "first_row": int(rows[0]),
            "first_column": int(columns[0]),
            "references": "Chew and Small 2020, doi:10.3390/rs12101558",
        },
    )
    dataset["SM_daily"].attrs |= {
        "standard_name": "volume_fraction_of_condensed_water_in_soil",
        "ancillary_variables": "SIGMA_daily count",
    }
    dataset["count"] = (dims, count, {**common, "long_name": "looks in the cell and day"})
    dataset["crs"] = ((), np.int32(6933), EASE_CRS)
    return dataset


def write_level3_cog(path: Path, grid: xr.Dataset, attributes: Mapping[str, Any]) -> None:
    """The grid of ``level3_grid`` as a COG in EPSG:6933: bands ``SM_daily``, ``SIGMA_daily`` and ``count`` of each day,
    the day after the name (``SM_daily 2024-03-01``), float32, -9999 where there is none.
    """
    transform = corner_transform(grid, 9 if grid.attrs["grid"] == ease_grid(9).name else 36)
    bands = {
        f"{name} {np.datetime_as_string(day, unit='D')}": grid[name].to_numpy()[index].astype(np.float32)
        for index, day in enumerate(grid["time"].to_numpy())
        for name in ("SM_daily", "SIGMA_daily", "count")
    }
    write_cog(path, bands, transform=transform, crs="EPSG:6933", nodata=FILL, attributes=attributes)
