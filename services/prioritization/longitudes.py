"""Longitudes as everything here has them, whichever way a grid counts."""

from __future__ import annotations

import numpy as np
import xarray as xr


def signed(dataset: xr.Dataset) -> xr.Dataset:
    """A grid whose longitudes beyond 180 degrees (as weather models count) are -180..0, its columns as they were.

    Without that a fire at 108 W would lie off a grid that holds it at 252.
    """
    if "longitude" not in dataset.coords:
        return dataset
    longitude = dataset["longitude"].to_numpy()
    if longitude.dtype.kind != "f" or not (longitude > 180).any():
        return dataset
    wrapped = np.where(longitude > 180, longitude - 360, longitude)
    return dataset.assign_coords(longitude=(dataset["longitude"].dims, wrapped, dataset["longitude"].attrs))
