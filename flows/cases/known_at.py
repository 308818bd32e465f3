"""What of a case was known at a time: the one truth about time, for every kind of input."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd
import xarray as xr

from shared.contracts import tables
from shared.contracts.schema import read_table
from shared.errors import DomainError


class KnownInputs(Protocol):
    """Case inputs by logical name: a Case, or the same files wherever a store keeps them."""

    def path(self, logical: str) -> Path: ...

    def has(self, logical: str) -> bool: ...


def detections_known_at(case: KnownInputs, cutoff: datetime) -> pd.DataFrame:
    """The detections delivered by the cut-off (contract ``detections``)."""
    table = read_table(case.path("detections"), tables.DETECTIONS)
    return table[table.delivered_at <= pd.Timestamp(cutoff)].reset_index(drop=True)


def perimeters_known_at(case: KnownInputs, cutoff: datetime) -> pd.DataFrame:
    """The perimeters published by the cut-off (contract ``perimeters``)."""
    table = read_table(case.path("perimeters"), tables.PERIMETERS)
    return table[table.known_at <= pd.Timestamp(cutoff)].reset_index(drop=True)


def incidents_known_at(case: KnownInputs, cutoff: datetime) -> pd.DataFrame:
    """The incidents known by the cut-off, each with the area last reported by then (contract ``incidents``)."""
    table = read_table(case.path("incidents"), tables.INCIDENTS)
    table = table[table.known_at <= pd.Timestamp(cutoff)].reset_index(drop=True)
    if not case.has("incident_reports"):
        return table
    reports = pd.read_parquet(case.path("incident_reports"))
    reports = reports[reports.known_at <= pd.Timestamp(cutoff)].sort_values("known_at", kind="stable")
    latest = reports.groupby("incident_id").area_km2.last()
    table["area_km2"] = table.incident_id.map(latest).fillna(table.area_km2)
    return table


def weather_known_at(case: KnownInputs, cutoff: datetime, from_time: datetime | None = None) -> xr.Dataset:
    """One weather grid for a cycle: analyses issued by the cut-off, then the last forecast issued by then.

    Hourly (time, latitude, longitude) with ``issued_at`` (time) as the weather contract asks, from ``from_time``
    (default: the first analysis). DomainError where no forecast had been issued.
    """
    limit = np.datetime64(pd.Timestamp(cutoff).tz_convert(None))
    with xr.open_dataset(case.path("weather_analysis")) as opened:
        analysis = opened.load()
    with xr.open_dataset(case.path("weather_forecast")) as opened:
        issues = opened["issue"].values
        if not (issues <= limit).any():
            raise DomainError(
                f"No forecast had been issued by {cutoff}.",
                field="cutoff",
                value=cutoff,
                accepted=f"from {issues.min()}",
            )
        forecast = opened.isel(issue=int(np.flatnonzero(issues <= limit)[-1])).load()
    analysis = analysis.isel(time=np.flatnonzero(analysis["issued_at"].values <= limit))
    if from_time is not None:
        first = np.datetime64(pd.Timestamp(from_time).tz_convert(None))
        analysis = analysis.isel(time=np.flatnonzero(analysis["time"].values >= first))
    return _joined(analysis, forecast)


def _joined(analysis: xr.Dataset, forecast: xr.Dataset) -> xr.Dataset:
    """Analyses, then the hours of the forecast after the last of them."""
    issue = forecast["issue"].values
    ahead = forecast.rename(lead="time").assign_coords(time=forecast["valid_at"].values)
    ahead = ahead.drop_vars(["issue", "valid_at"], errors="ignore")
    ahead = ahead.assign_coords(issued_at=("time", np.full(ahead.sizes["time"], issue)))
    if analysis.sizes["time"]:
        ahead = ahead.isel(time=np.flatnonzero(ahead["time"].values > analysis["time"].values[-1]))
    joined = xr.concat([analysis, ahead], dim="time", combine_attrs="drop_conflicts")
    for name in ("time", "issued_at"):
        joined[name].encoding = {"units": "seconds since 2000-01-01 00:00:00", "dtype": "int64"}
    return joined
