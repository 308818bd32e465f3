"""The fire-arrival product: CF netCDF dataset on the fire's UTM grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from services.arrival.front.rates import rate_of_spread_km_h
from services.arrival.grid import FireGrid
from services.arrival.inference import ArrivalMap
from services.arrival.sight import HIDDEN, MEANINGS, Sight, sight_of

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


def _flags(values: NDArray[np.unsignedinteger], meanings: str, long_name: str) -> xr.Variable:
    codes = np.arange(len(meanings.split()), dtype=np.int8)
    attributes = {"long_name": long_name, "grid_mapping": "crs", "flag_values": codes, "flag_meanings": meanings}
    return xr.Variable(("y", "x"), values.astype(np.int8), attributes)


def _probability(values: Floats, long_name: str) -> xr.Variable:
    attributes = {"long_name": long_name, "units": "1", "grid_mapping": "crs"}
    return xr.Variable(("y", "x"), values.astype(np.float32), attributes)


def _rate_of_spread(arrival: ArrivalMap) -> xr.Variable:
    rate = rate_of_spread_km_h(arrival.arrival_h, arrival.grid.cell_m / 1e3)
    attributes = {"long_name": "rate of spread of the front as it arrived", "units": "km h-1", "grid_mapping": "crs"}
    variable = xr.Variable(("y", "x"), rate.astype(np.float32), attributes)
    variable.encoding["_FillValue"] = np.float32(np.nan)
    return variable


def _known(sight: Sight, reference: pd.Timestamp) -> dict[str, xr.Variable]:
    """The contract's `information` and `latest_observation`, and the finer state that tells cloud from no pass."""
    information = np.maximum(sight.state, HIDDEN) - HIDDEN  # no pass and hidden are both "not seen"
    return {
        "information": _flags(
            information, "not_seen no_fire_seen fire_seen", "what was known of the cell by the end of the period"
        ),
        "look_state": _flags(
            sight.state,
            " ".join(MEANINGS),
            "whether the cell was passed over, hidden, or seen, by the end of the period",
        ),
        "latest_observation": _seconds(sight.clear_h, reference, "time of the latest look that saw the cell"),
        "latest_hidden_pass": _seconds(
            sight.hidden_h, reference, "time of the latest pass over the cell that cloud, water or glint hid"
        ),
    }


def to_dataset(
    arrival: ArrivalMap,
    reference: pd.Timestamp,
    incident_id: str,
    attributes: Mapping[str, Any],
    sight: Sight | None = None,
    front24: Floats | None = None,
) -> xr.Dataset:
    """Dataset of the fire_arrival contract; times are float64 seconds since `reference_time`, unburned and unseen
    cells NaN. `front24` is the probability that the fire arrives within the 24 h after the end of the period."""
    times = {
        "fire_arrival_time": (arrival.arrival_h, "time of fire arrival"),
        "fire_arrival_time_q05": (arrival.q05_h, "5 % quantile of the time of fire arrival"),
        "fire_arrival_time_q50": (arrival.arrival_h, "50 % quantile of the time of fire arrival"),
        "fire_arrival_time_q95": (arrival.q95_h, "95 % quantile of the time of fire arrival"),
    }
    variables = {name: _seconds(hours, reference, text) for name, (hours, text) in times.items()}
    variables["fire_arrival_time_sd"] = _seconds(
        arrival.sd_h, reference, "standard deviation of the time of fire arrival", duration=True
    )
    variables["burned_probability"] = _probability(
        arrival.burned_probability, "probability that the cell had burned by the end of the period"
    )
    variables["rate_of_spread"] = _rate_of_spread(arrival)
    variables |= _known(sight if sight is not None else sight_of(arrival), reference)
    if front24 is not None:
        variables["front24_probability"] = _probability(
            front24, "probability that the fire arrives within the 24 h after the end of the period"
        )
    variables["crs"] = _crs_variable(arrival.grid)
    own = {
        "incident_id": incident_id,
        "reference_time": iso(reference),
        "flags": " ".join(arrival.flags) or "none",
        "title": f"Fire arrival time of {incident_id}",
    }
    return xr.Dataset(variables, _coordinates(arrival.grid), {**attributes, **own})
