"""From the inputs of a request to the tables of its fires: files of any kind read, cut to the period, counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pandas as pd
from shapely import get_coordinates

from services.arrival.assignment import Assignment
from services.arrival.fires import FireCase, build_case, within
from services.arrival.front.weather import HourlyWeather, weather_at, weather_in
from services.arrival.looks import confident
from services.arrival.readers.granules import Area
from services.arrival.readers.sources import Reading, file_kind, read_active_fire
from shared.errors import DomainError

if TYPE_CHECKING:
    import xarray as xr

    from shared.artifacts.reference import ArtifactRef
    from shared.process import JobContext

# Granules are cut to this far around an incident beyond the map's margin: as far as a fire may have come.
REACH_KM = 40.0
KM_PER_DEGREE = 111.2


@dataclass(frozen=True)
class Tables:
    """The tables of a request up to its end, and what was left out of them."""

    detections: gpd.GeoDataFrame
    obscured: gpd.GeoDataFrame
    burned_area: gpd.GeoDataFrame
    known: gpd.GeoDataFrame
    incidents: gpd.GeoDataFrame
    end: pd.Timestamp
    counts: dict[str, int]
    files: list[dict[str, object]] = field(default_factory=list)


def areas_of(incidents: gpd.GeoDataFrame, reach_km: float) -> list[Area]:
    """A box in degrees around every incident, `reach_km` beyond its geometry; west > east across the antimeridian."""
    areas = []
    for geometry in incidents.geometry:
        lon, lat = get_coordinates(geometry).T
        off = (lon - lon[0] + 180.0) % 360.0 - 180.0
        pad = reach_km / KM_PER_DEGREE
        wide = pad / max(float(np.cos(np.radians(np.abs(lat).max()))), 0.1)
        west, east = ((lon[0] + edge + 180.0) % 360.0 - 180.0 for edge in (off.min() - wide, off.max() + wide))
        areas.append((float(west), float(lat.min() - pad), float(east), float(lat.max() + pad)))
    return areas


def _joined(parts: Sequence[pd.DataFrame]) -> gpd.GeoDataFrame:
    """The rows of all parts; an empty table of the first one's columns where none has any."""
    filled = [part for part in parts if len(part)]
    if not filled:
        return parts[0].iloc[:0]
    return gpd.GeoDataFrame(pd.concat(filled, ignore_index=True), geometry="geometry", crs="EPSG:4326")


def _readings(references: Sequence[ArtifactRef], areas: list[Area], context: JobContext) -> list[Reading]:
    readings = []
    for reference in references:
        path = context.path(reference)
        if file_kind(path, reference.name) == "table":
            frame = context.read_table(reference, "DETECTIONS")
            report = {"name": reference.name, "format": "detections table", "rows": len(frame)}
            readings.append(Reading(frame, frame.iloc[:0], report))
        else:
            readings.append(read_active_fire(path, areas, reference.name))
    return readings


def gather_tables(inputs: Any, context: JobContext) -> Tables:
    """Read every input of a request of `infer-fire-arrival`. Raises DomainError or ContractError naming the file or
    the field at fault."""
    start, end = (pd.Timestamp(moment).tz_convert("UTC") for moment in (inputs.start, inputs.end))
    incidents = context.read_table(inputs.incidents, "INCIDENTS")
    informed = incidents[(incidents["known_at"] <= end) & (incidents["start"] <= end)].reset_index(drop=True)
    references = inputs.detections if isinstance(inputs.detections, list) else [inputs.detections]
    readings = _readings(references, areas_of(informed, inputs.margin_km + REACH_KM), context)
    read = _joined([reading.detections for reading in readings])
    period = within(read, start, end)
    detections = confident(period, inputs.min_confidence).reset_index(drop=True)
    obscured = within(_joined([reading.obscured for reading in readings]), start, end)
    burned = [context.read_table(reference, "BURNED_AREA") for reference in inputs.burned_area]
    empty = gpd.GeoDataFrame({"time": pd.Series(dtype="datetime64[ms, UTC]")}, geometry=gpd.GeoSeries([], crs=4326))
    burned_area = _joined([within(part, start, end) for part in burned]) if burned else empty
    known, unusable = _known_places(inputs, context, informed, end)
    counts = {
        "detections_read": len(read),
        "detections_outside_period": len(read) - len(period),
        "detections_low_confidence": len(period) - len(detections),
        "incidents_not_yet_known": len(incidents) - len(informed),
        **unusable,
    }
    files = [reading.report for reading in readings]
    return Tables(detections, obscured, burned_area, known, informed, end, counts, files)


def _known_places(
    inputs: Any, context: JobContext, incidents: gpd.GeoDataFrame, end: pd.Timestamp
) -> tuple[gpd.GeoDataFrame, dict[str, int]]:
    """Perimeters and ignition points that were known by the end, and counts of those left out. Raises DomainError for
    an ignition that is no point."""
    perimeters = [context.read_table(reference, "PERIMETERS") for reference in inputs.perimeters]
    ignitions = [context.read_table(reference, "PERIMETERS") for reference in inputs.ignitions]
    for table in ignitions:
        wrong = np.flatnonzero(~table.geometry.geom_type.isin(["Point", "MultiPoint"]).to_numpy())
        if wrong.size:
            raise DomainError(
                f"ignitions: row {int(wrong[0])} is no point",
                field="ignitions.geometry",
                value=table.geometry.iloc[wrong[0]].geom_type,
                accepted="Point or MultiPoint",
            )
    if not (perimeters or ignitions):
        empty = gpd.GeoDataFrame({"incident_id": [], "time": []}, geometry=gpd.GeoSeries([], crs=4326))
        return empty, {}
    whole = _joined([*perimeters, *ignitions])
    timely = whole[(whole["time"] <= end) & (whole["known_at"] <= end)]
    own = timely[timely["incident_id"].isin(incidents["incident_id"])].reset_index(drop=True)
    left_out = {
        "perimeters_not_yet_known": len(whole) - len(timely),
        "perimeters_of_other_incidents": len(timely) - len(own),
    }
    return own, left_out


def cases_of(tables: Tables, assignment: Assignment, inputs: Any) -> list[FireCase]:
    """The case of every incident, in the order of the incidents."""
    cases = []
    for _, incident in tables.incidents.iterrows():
        known = tables.known[tables.known["incident_id"] == incident["incident_id"]]
        cases.append(
            build_case(
                incident,
                tables.detections,
                tables.burned_area,
                assignment,
                tables.end,
                inputs.cell_m,
                inputs.margin_km,
                inputs.seed,
                known if len(known) else None,
            )
        )
    return cases


def read_weather(inputs: Any, context: JobContext) -> xr.Dataset | pd.DataFrame | None:
    """The weather of a request: a CF grid (netCDF) or a table of points (Parquet); None where none is given."""
    if inputs.weather is None:
        return None
    if context.path(inputs.weather).suffix in (".parquet", ".geoparquet"):
        return context.read_table(inputs.weather, "WEATHER")
    from shared.contracts.grids import WEATHER_GRID, read_netcdf

    return read_netcdf(context.path(inputs.weather), WEATHER_GRID)


def weather_of(
    weather: xr.Dataset | pd.DataFrame | None, case: FireCase, end: pd.Timestamp
) -> tuple[HourlyWeather | None, tuple[str, ...]]:
    """Weather at a fire, or None with a flag where the weather that is given does not reach it."""
    if weather is None:
        return None, ()
    lon, lat = (float(v) for v in case.grid.degrees(case.grid.x_m.mean(), case.grid.y_m.mean()))
    find = weather_in if isinstance(weather, pd.DataFrame) else weather_at
    try:
        return find(weather, lon, lat, case.reference, end), ()
    except DomainError:
        return None, ("weather-out-of-reach",)
