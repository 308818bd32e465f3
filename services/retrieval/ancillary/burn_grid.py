"""Burn times on a grid, as nature runs and burned-area rasters give them: read into UTC milliseconds and axes."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from shared.errors import DomainError


def burn_times(dataset: xr.Dataset) -> tuple[NDArray[np.datetime64], NDArray[np.float64], NDArray[np.float64]]:
    """``burn_time`` (latitude, longitude; NaT unburned) with its ascending axes in degrees, longitude -180..180.

    The variable is datetime, or seconds since ``reference_time`` (its own attribute or the dataset's) with NaN where
    unburned. DomainError where it is missing, or numbers without a reference.
    """
    if "burn_time" not in dataset.variables:
        raise DomainError("The grid lacks burn_time.", field="burn_time", accepted="burn_time (latitude, longitude)")
    burn = dataset["burn_time"]
    row_axis, column_axis = map(str, burn.dims)
    latitude = _axis(dataset, row_axis, "latitude")
    longitude = (_axis(dataset, column_axis, "longitude") + 180.0) % 360.0 - 180.0
    rows, columns = np.argsort(latitude, kind="stable"), np.argsort(longitude, kind="stable")
    return _as_times(burn, dataset)[np.ix_(rows, columns)], latitude[rows], longitude[columns]


def _axis(dataset: xr.Dataset, axis: str, kind: str) -> NDArray[np.float64]:
    for name in (axis, f"{kind}_burn", kind):
        if name in dataset.variables and dataset[name].dims == (axis,):
            values = dataset[name].to_numpy().astype(np.float64)
            if np.abs(values).max() <= 360.0:
                return values
    raise DomainError(
        f"burn_time has the axis '{axis}' without a {kind} in degrees.",
        field="burn_time",
        accepted="dimensions latitude_burn, longitude_burn with coordinates in degrees",
    )


def _as_times(burn: xr.DataArray, dataset: xr.Dataset) -> NDArray[np.datetime64]:
    values = burn.to_numpy()
    if values.dtype.kind == "M":
        return values.astype("datetime64[ms]")
    reference = burn.attrs.get("reference_time", dataset.attrs.get("reference_time"))
    if reference is None:
        raise DomainError("burn_time is numeric but no reference_time is given.", field="burn_time.reference_time")
    start = np.datetime64(str(reference).replace("Z", "").split("+")[0], "ms")
    if values.dtype.kind == "m":  # decoded from units of plain seconds
        return start + values.astype("timedelta64[ms]")
    known = np.isfinite(values)
    milliseconds = np.round(np.where(known, values, 0.0).astype(np.float64) * 1e3).astype("timedelta64[ms]")
    return np.where(known, start + milliseconds, np.datetime64("NaT", "ms"))
