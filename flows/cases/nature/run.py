"""A whole nature run: the fires of a setting on its ground, under its weather, and their truth as grids and tables."""

from __future__ import annotations

from dataclasses import dataclass

import geopandas
import numpy as np
import pandas as pd
import xarray as xr
from pyproj import CRS, Transformer

from flows.cases.nature.land import Land, make_land
from flows.cases.nature.setting import FloatArray, Setting
from flows.cases.nature.spread import FireGrid, burn
from flows.cases.nature.weather import Weather, make_weather

REPORT_EVERY_H = 6.0


@dataclass(frozen=True)
class NatureRun:
    """Ground, weather and fires made from one setting."""

    setting: Setting
    land: Land
    weather: Weather
    fires: tuple[FireGrid, ...]


def make_nature(setting: Setting) -> NatureRun:
    """The nature run of a setting: the same setting gives the same run."""
    land = make_land(setting)
    weather = make_weather(setting, land)
    fires = tuple(burn(setting, land, weather, ignition) for ignition in setting.ignitions)
    return NatureRun(setting, land, weather, fires)


def burned_km2(fire: FireGrid, time_h: float) -> float:
    """Area burned by a time (hours since the run's start), km²."""
    cell_km2 = abs((fire.x_m[1] - fire.x_m[0]) * (fire.y_m[1] - fire.y_m[0])) / 1e6
    return float(np.count_nonzero(fire.arrival_h <= time_h) * cell_km2)


def truth_dataset(setting: Setting, fires: tuple[FireGrid, ...], reference_time: str) -> xr.Dataset:
    """Fire arrival of every incident on a UTM window of its own, s, NaN unburned: ``fire_arrival_time_<id>``."""
    dataset = xr.Dataset(attrs={"reference_time": reference_time, "source": "simulated"})
    for fire in fires:
        label = fire.incident_id
        dims = (f"y_{label}", f"x_{label}")
        seconds = np.round(fire.arrival_h * 3600.0).astype(np.float32)
        attributes = {"units": "s", "reference_time": reference_time, "grid_mapping": "crs", "incident_id": label}
        dataset[f"fire_arrival_time_{label}"] = (dims, seconds, attributes)
        dataset = dataset.assign_coords(
            {
                dims[0]: (dims[0], fire.y_m, {"units": "m", "standard_name": "projection_y_coordinate"}),
                dims[1]: (dims[1], fire.x_m, {"units": "m", "standard_name": "projection_x_coordinate"}),
            }
        )
    crs = CRS.from_epsg(setting.utm_epsg)
    dataset["crs"] = ((), np.int32(0), {"crs_wkt": crs.to_wkt(), "grid_mapping_name": "transverse_mercator"})
    return dataset


def burn_grid(setting: Setting, fires: tuple[FireGrid, ...]) -> FloatArray:
    """Earliest burn time on the burn grid (latitude_burn, longitude_burn): s since the run's start, NaN unburned."""
    longitude, latitude = setting.axes(setting.burn_step_deg)
    result = np.full((len(latitude), len(longitude)), np.nan)
    for fire in fires:
        back = Transformer.from_crs(fire.epsg, 4326, always_xy=True)
        corners = back.transform(*np.meshgrid(fire.x_m[[0, -1]], fire.y_m[[0, -1]]))
        rows = np.flatnonzero((latitude >= corners[1].min()) & (latitude <= corners[1].max()))
        columns = np.flatnonzero((longitude >= corners[0].min()) & (longitude <= corners[0].max()))
        if not (len(rows) and len(columns)):
            continue
        window = np.ix_(rows, columns)
        seconds = sample(fire, *np.meshgrid(longitude[columns], latitude[rows])) * 3600.0
        result[window] = np.fmin(result[window], np.round(seconds))
    return result


def sample(fire: FireGrid, longitude: FloatArray, latitude: FloatArray) -> FloatArray:
    """Arrival (h since start) of the cells at positions in degrees; NaN unburned or outside the window."""
    x, y = Transformer.from_crs(4326, fire.epsg, always_xy=True).transform(longitude, latitude)
    columns = np.rint((x - fire.x_m[0]) / (fire.x_m[1] - fire.x_m[0])).astype(int)
    rows = np.rint((y - fire.y_m[0]) / (fire.y_m[1] - fire.y_m[0])).astype(int)
    inside = (rows >= 0) & (rows < len(fire.y_m)) & (columns >= 0) & (columns < len(fire.x_m))
    values = np.full(np.shape(longitude), np.nan)
    values[inside] = fire.arrival_h[rows[inside], columns[inside]]
    return values


def incidents_table(run: NatureRun) -> geopandas.GeoDataFrame:
    """The incidents as first reported (contract ``incidents``): start to the half hour, area coarse."""
    setting, rows = run.setting, []
    reports = incident_reports(run)
    for ignition in setting.ignitions:
        first = reports[reports.incident_id == ignition.incident_id].iloc[0]
        start_h = setting.cutoff_h + ignition.start_h
        rows.append(
            {
                "incident_id": ignition.incident_id,
                "name": ignition.name,
                "start": pd.Timestamp(setting.time(np.floor(start_h * 2) / 2)),
                "area_km2": first.area_km2,
                "known_at": first.known_at,
            }
        )
    points = geopandas.points_from_xy(
        [i.longitude_deg for i in setting.ignitions], [i.latitude_deg for i in setting.ignitions]
    )
    return geopandas.GeoDataFrame(pd.DataFrame(rows), geometry=points, crs=4326)


def incident_reports(run: NatureRun) -> pd.DataFrame:
    """Every six hours a report of each fire's area, off by up to 30 % and rounded: incident_id, known_at, area_km2."""
    setting, rows = run.setting, []
    for fire, ignition in zip(run.fires, setting.ignitions, strict=True):
        rng = setting.generator(f"reports {ignition.incident_id}")
        first_h = setting.cutoff_h + ignition.start_h + ignition.known_after_h
        for hour in np.arange(first_h, max(setting.end_h, first_h) + 0.01, REPORT_EVERY_H):
            area = burned_km2(fire, hour - 1.0) * rng.uniform(0.7, 1.15)
            known = pd.Timestamp(setting.time(hour))
            rows.append({"incident_id": ignition.incident_id, "known_at": known, "area_km2": _coarse(area)})
    return pd.DataFrame(rows)


def _coarse(area_km2: float) -> float:
    """Two significant figures, and nothing under a tenth of a square kilometre."""
    return max(float(f"{area_km2:.2g}"), 0.1)
