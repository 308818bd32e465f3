"""The situation that build-targets prices, read from its artifacts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import xarray as xr

from services.prioritization import fire_reports, observation_age, sources
from services.prioritization.active_targets import Situation
from services.prioritization.fire_reports import Previous
from shared.contracts import grids
from shared.errors import DomainError

if TYPE_CHECKING:
    from services.prioritization.processes import BuildTargetsInputs
    from shared.process import JobContext


def read(inputs: BuildTargetsInputs, context: JobContext) -> Situation:
    """Every table checked against its contract; arrival maps by their incident."""
    incidents: Any = context.read_table(inputs.incidents, "INCIDENTS")
    detections: Any = context.read_table(inputs.detections, "DETECTIONS") if inputs.detections else None
    burned: list[Any] = [context.read_table(ref, "BURNED_AREA") for ref in inputs.burned_area]
    ratings = context.read_table(inputs.ratings, "RATINGS")
    given = context.read_table(inputs.previous_ratings, "RATINGS") if inputs.previous_ratings else None
    last = context.read_json(inputs.previous_report) if inputs.previous_report else {}
    time = sources.to_utc(inputs.time)
    return Situation(
        time=time,
        horizon_h=inputs.horizon_h,
        area=inputs.area,
        incidents=incidents,
        ratings=ratings,
        detections=detections,
        arrival_maps=arrival_maps([context.path(ref) for ref in inputs.fire_arrival]),
        burned_area=burned,
        observed=_observed(context.path(inputs.observed)) if inputs.observed else None,
        previous=Previous(fire_reports.previous_ratings(ratings, given, time), _reported_fires(last)),
    )


def _reported_fires(report: Any) -> dict[str, dict[str, Any]]:
    """The rows of an earlier report by incident; DomainError if it is no report of build-targets."""
    if not report:
        return {}
    fires = report.get("fires") if isinstance(report, dict) else None
    if not isinstance(fires, list) or not all(isinstance(row, dict) and "incident_id" in row for row in fires):
        raise DomainError(
            "The previous report lists no fires.", field="previous_report", accepted="report.json of build-targets"
        )
    return {str(row["incident_id"]): row for row in fires}


def arrival_maps(paths: list[Path]) -> dict[str, xr.Dataset]:
    """Arrival maps by incident, seconds left as numbers; DomainError if two are of one incident."""
    maps: dict[str, xr.Dataset] = {}
    for path in paths:
        dataset = grids.read_netcdf(path, grids.FIRE_ARRIVAL, decode_times=False)
        incident = str(dataset.attrs["incident_id"])
        if incident in maps:
            raise DomainError(
                f"Two arrival maps are of incident '{incident}'.",
                field="fire_arrival",
                value=incident,
                accepted="one each",
            )
        maps[incident] = dataset
    return maps


def read_danger(path: Path) -> xr.Dataset:
    """The danger grid, checked."""
    return grids.read_netcdf(path, grids.DANGER)


def _observed(path: Path) -> pd.DataFrame:
    try:
        table = pd.read_parquet(path)
    except (ValueError, OSError) as error:
        raise DomainError(
            "The table of observations is not Parquet.", field="observed", accepted=", ".join(observation_age.COLUMNS)
        ) from error
    return observation_age.check_observed(table)
