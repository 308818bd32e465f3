"""The fire-arrival product: CF netCDF dataset on the fire's UTM grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from services.arrival.extent import NOT_SEEN
from services.arrival.grid import FireGrid
from services.arrival.inference import ArrivalMap

Floats = NDArray[np.float64]


def iso(time: pd.Timestamp) -> str:
    """UTC time as ISO 8601 with Z, whole seconds."""
    return time.tz_convert("UTC").strftime("%Y-%m-%dT%H:%M:%SZ")


def _coordinates(grid: FireGrid) -> dict[str, Any]:
    standard = {"x": "projection_x_coordinate", "y": "projection_y_coordinate"}
    return {
        axis: (axis, values, {"standard_name": standard[axis], "units": "m", "axis": axis.upper()})
        for axis, values in (("x", grid.x_m), ("y", grid.y_m))
    }


def _crs_variable(grid: FireGrid) -> xr.Variable:
    attributes = {name: value for name, value in grid.crs.to_cf().items() if value is not None}
    left, bottom = grid.x_m[0] - grid.cell_m / 2, grid.y_m[0] - grid.cell_m / 2
    attributes["GeoTransform"] = f"{left} {grid.cell_m} 0 {bottom} 0 {grid.cell_m}"
    attributes["epsg_code"] = f"EPSG:{grid.epsg}"
    return xr.Variable((), np.int32(0), attributes)


def _seconds(hours: Floats, reference: pd.Timestamp, long_name: str, *, duration: bool = False) -> xr.Variable:
    units = "s" if duration else f"seconds since {reference.tz_convert('UTC').strftime('%Y-%m-%d %H:%M:%S')}"
    variable = xr.Variable(
        ("y", "x"), np.round(hours * 3600.0), {"long_name": long_name, "units": units, "grid_mapping": "crs"}
    )
    if not duration:
        variable.attrs["calendar"] = "standard"
    variable.encoding["_FillValue"] = np.nan
    return variable


def to_dataset(
    arrival: ArrivalMap, reference: pd.Timestamp, incident_id: str, attributes: Mapping[str, Any]
) -> xr.Dataset:
    """Dataset of the fire_arrival contract; times are float64 seconds since `reference_time`, unburned and unseen
    cells NaN."""
    evidence = arrival.evidence
    information = xr.Variable(
        ("y", "x"),
        evidence.information.astype(np.int8),
        {
            "long_name": "what was known of the cell by the end of the period",
            "grid_mapping": "crs",
            "flag_values": np.array([0, 1, 2], np.int8),
            "flag_meanings": "not_seen no_fire_seen fire_seen",
        },
    )
    probability = xr.Variable(
        ("y", "x"),
        arrival.burned_probability.astype(np.float32),
        {
            "long_name": "probability that the cell had burned by the end of the period",
            "units": "1",
            "grid_mapping": "crs",
        },
    )
    latest = np.where(evidence.information == NOT_SEEN, np.nan, evidence.latest_h)
    variables = {
        "fire_arrival_time": _seconds(arrival.arrival_h, reference, "time of fire arrival"),
        "fire_arrival_time_sd": _seconds(
            arrival.sd_h, reference, "standard deviation of the time of fire arrival", duration=True
        ),
        "fire_arrival_time_q05": _seconds(arrival.q05_h, reference, "5 % quantile of the time of fire arrival"),
        "fire_arrival_time_q50": _seconds(arrival.arrival_h, reference, "50 % quantile of the time of fire arrival"),
        "fire_arrival_time_q95": _seconds(arrival.q95_h, reference, "95 % quantile of the time of fire arrival"),
        "burned_probability": probability,
        "information": information,
        "latest_observation": _seconds(latest, reference, "time of the latest look that covered the cell"),
        "crs": _crs_variable(arrival.grid),
    }
    own = {
        "incident_id": incident_id,
        "reference_time": iso(reference),
        "flags": " ".join(arrival.flags) or "none",
        "title": f"Fire arrival time of {incident_id}",
    }
    return xr.Dataset(variables, _coordinates(arrival.grid), {**attributes, **own})
