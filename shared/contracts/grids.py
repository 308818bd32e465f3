"""Grids that services exchange: contracts, and CF-1.11 netCDF written so that the same data give the same bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from shared.errors import ContractError


@dataclass(frozen=True)
class GridSchema:
    """A grid contract: the variables that must be there, with their dimensions, and the global attributes."""

    name: str
    variables: Mapping[str, tuple[str, ...]]
    attributes: tuple[str, ...] = ()

    def check(self, dataset: xr.Dataset) -> xr.Dataset:
        """The dataset itself, or ContractError naming the first variable or attribute at fault."""
        for variable, dimensions in self.variables.items():
            if variable not in dataset.variables:
                raise ContractError(
                    f"Grid '{self.name}' lacks the variable '{variable}'; "
                    f"it has {', '.join(map(str, dataset.variables))}.",
                    field=variable,
                    accepted=", ".join(self.variables),
                )
            found = tuple(map(str, dataset[variable].dims))
            if found != dimensions:
                raise ContractError(
                    f"Grid '{self.name}', variable '{variable}' has dimensions {found}; accepted: {dimensions}.",
                    field=variable,
                    value=found,
                    accepted=str(dimensions),
                )
        for attribute in self.attributes:
            if attribute not in dataset.attrs:
                raise ContractError(f"Grid '{self.name}' lacks the attribute '{attribute}'.", field=attribute)
        return dataset


_DANGER = ("lead_day", "latitude", "longitude")
DANGER = GridSchema(
    "danger",
    dict.fromkeys(("wfpi", "wlfp", "wfsp", "wfpi_x", "wlfp_x", "wfsp_x"), _DANGER)
    | {"mask_code": ("latitude", "longitude")},
)

_ARRIVAL = ("y", "x")
FIRE_ARRIVAL = GridSchema(
    "fire_arrival",
    dict.fromkeys(
        (
            "fire_arrival_time",
            "fire_arrival_time_sd",
            "fire_arrival_time_q05",
            "fire_arrival_time_q50",
            "fire_arrival_time_q95",
            "burned_probability",
            "information",
            "latest_observation",
        ),
        _ARRIVAL,
    )
    | {"crs": ()},
    ("reference_time", "incident_id"),
)

_HOURLY = ("time", "latitude", "longitude")
WEATHER_GRID = GridSchema(
    "weather grid",
    dict.fromkeys(
        ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "wind_direction_deg", "rain_mm"), _HOURLY
    )
    | {"issued_at": ("time",)},
)

_FUELS = ("latitude", "longitude")
FUELS = GridSchema(
    "fuels",
    dict.fromkeys(("ndvi", "ndvi_min", "ndvi_max", "live_load", "dead_load", "extinction_pct", "mask_code"), _FUELS),
)

ALL: dict[str, GridSchema] = {name: value for name, value in globals().items() if isinstance(value, GridSchema)}


def write_netcdf(path: str | Path, dataset: xr.Dataset, attributes: Mapping[str, Any] | None = None) -> None:
    """Write netCDF-4 (zlib), attributes sorted, no history and no clock: the same data give the same bytes."""
    stamped = dataset.copy()
    merged = {"Conventions": "CF-1.11, ACDD-1.3", **dataset.attrs, **(attributes or {})}
    stamped.attrs = {name: _plain(merged[name]) for name in sorted(merged)}
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in stamped.variables.items():
        if variable.ndim and variable.dtype.kind in "fiub":
            encoding[str(name)] = {"zlib": True, "complevel": 4}
    stamped.to_netcdf(path, engine="netcdf4", format="NETCDF4", encoding=encoding)


def read_netcdf(path: str | Path, schema: GridSchema | None = None, *, decode_times: bool = True) -> xr.Dataset:
    """Load a netCDF file whole and check it against its contract; ContractError if it is no netCDF or breaks it."""
    try:
        with xr.open_dataset(path, engine="netcdf4", decode_times=decode_times) as opened:
            dataset = opened.load()
    except (OSError, ValueError, RuntimeError) as error:  # a damaged chunk is a RuntimeError of netCDF4
        name = schema.name if schema else Path(path).name
        raise ContractError(f"Grid '{name}' cannot be read as netCDF: {error}", field=name) from error
    return schema.check(dataset) if schema else dataset


def _plain(value: Any) -> Any:
    """netCDF attributes hold no booleans and no None."""
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    return value
