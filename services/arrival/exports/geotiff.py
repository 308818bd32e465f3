"""The arrival map as Cloud-Optimised GeoTIFFs: its numbers, and what was known of each cell as coloured classes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.transform import Affine

from services.arrival.grid import FireGrid
from services.arrival.inference import ArrivalMap
from services.arrival.sight import BURNING, CLEAR, HIDDEN, NO_PASS, Sight
from shared.contracts.cog import write_cog

NODATA = -9999.0
COLOURS = {NO_PASS: (225, 225, 225), HIDDEN: (150, 165, 190), CLEAR: (178, 214, 165), BURNING: (214, 84, 46)}
Floats = NDArray[np.float64]


def transform_of(grid: FireGrid) -> Affine:
    """Affine map from (column, row from the north) of a cell's upper left corner to UTM metres."""
    left, top = grid.x_m[0] - grid.cell_m / 2, grid.y_m[-1] + grid.cell_m / 2
    return Affine(grid.cell_m, 0.0, left, 0.0, -grid.cell_m, top)


def _band(values: Floats) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.where(np.isfinite(values), values, NODATA)[::-1].astype(np.float32))


def arrival_bands(arrival: ArrivalMap, front24: Floats | None) -> dict[str, NDArray[np.float32]]:
    """Bands of the float32 GeoTIFF, north up: times in whole seconds since the reference time, -9999 where none."""
    seconds = {
        "fire_arrival_time": arrival.arrival_h,
        "fire_arrival_time_sd": arrival.sd_h,
        "fire_arrival_time_q05": arrival.q05_h,
        "fire_arrival_time_q95": arrival.q95_h,
    }
    bands = {name: _band(np.round(hours * 3600.0)) for name, hours in seconds.items()}
    bands["burned_probability"] = _band(arrival.burned_probability)
    if front24 is not None:
        bands["front24_probability"] = _band(front24)
    return bands


def write_arrival_geotiff(
    path: Path, arrival: ArrivalMap, front24: Floats | None, attributes: Mapping[str, Any]
) -> None:
    """Write the numbers of a map as one float32 COG, one band each; `attributes` (with `reference_time`) as tags."""
    write_cog(
        path,
        arrival_bands(arrival, front24),
        transform=transform_of(arrival.grid),
        crs=f"EPSG:{arrival.grid.epsg}",
        nodata=NODATA,
        attributes=attributes,
    )


def write_sight_geotiff(path: Path, sight: Sight, grid: FireGrid, attributes: Mapping[str, Any]) -> None:
    """Write what was known of each cell as a uint8 COG with colours: no pass, hidden, no fire seen, fire seen."""
    write_cog(
        path,
        {"information": np.ascontiguousarray(sight.state[::-1])},
        transform=transform_of(grid),
        crs=f"EPSG:{grid.epsg}",
        nodata=None,
        attributes=attributes,
        colormap=COLOURS,
    )
