"""The two pictures of the documentation: ``python -m tests.bench.prioritization.wfpi_picture FOLDER``.

A WFPI map of real weather (NAM analysis of 2018-09-17 00 UTC, held for the day; rain unknown, so none) and real
greenness (MODIS, September 2001), on the USGS grid; and the change that made-up soil moisture and burns bring.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.interpolate import griddata

from services.prioritization import weather
from services.prioritization.fire_weather import upper_air
from services.prioritization.prefire import conditions, danger, danger_map, danger_run, fuels, vegetation_2001
from shared.versions import RELEASE
from tests.bench.prioritization import conus_day

NAM = "nam_conus_20180917T00.grib2"
NOTE = "weather: NAM analysis of 2018-09-17 00 UTC, held · NDVI: MODIS 2001-09 between the extremes of 2001"


def held_weather(path: Path) -> weather.WeatherGrid:
    """The analysis on an even grid of half a degree, for 24 hours."""
    air = upper_air.read_grib(path)
    latitude, longitude = np.arange(21, 53.1, 0.5), np.arange(-128, -64.9, 0.5)
    places = np.stack([air.longitude_deg.ravel(), air.latitude_deg.ravel()], axis=-1)
    mesh = tuple(np.meshgrid(longitude, latitude))
    names = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s")
    fields = {name: griddata(places, air.surface[name].ravel(), mesh) for name in names}
    hours = pd.date_range(pd.Timestamp(air.time), periods=25, freq="h")[1:]
    dims = ("time", "latitude", "longitude")
    data: dict[str, Any] = {name: (dims, np.repeat(values[None], 24, axis=0)) for name, values in fields.items()}
    data["rain_mm"] = (dims, np.zeros((24, len(latitude), len(longitude))))
    return weather.weather_from_dataset(
        xr.Dataset(data, coords={"time": hours, "latitude": latitude, "longitude": longitude})
    )


def main() -> None:
    """Write the pictures."""
    data, out = Path(os.environ["SMOKEGLINT_DATA"]), Path(sys.argv[1])
    start = pd.Timestamp("2018-09-17T00:00:00Z")
    given = fuels.fuels_from_dataset(vegetation_2001.fuels(data / "vegetation", 9))
    source = danger_run.on_grid(given, "usgs-1km")
    daily = conditions.daily_conditions(held_weather(data / "weather" / NAM), None, start, 1)
    effects = danger.DangerEffects()
    looks = ([conus_day._soil_moisture()], [conus_day._burned_area()])
    for name, soil, burned in (("wfpi_conus", [], []), ("wfpi_change", *looks)):
        later = [table.assign(time=table["time"] + (start - conus_day.START)) for table in (*soil, *burned)]
        seen = danger.seen_land(source.grid, later[: len(soil)], later[len(soil) :], start, effects)
        rated = danger_run.rate(source, daily, seen, start, effects=effects)
        note = NOTE + (" · soil moisture and burns made up" if soil else "")
        picture = danger_map.picture_of(rated, note)
        attributes = {"simulated": bool(soil), "simulated_share": 0.5 * bool(soil)}
        attributes |= {"oldest_input": "2001-09-01", "code_version": RELEASE}
        draw = danger_map.draw_changes if soil else danger_map.draw
        draw(picture, out / f"prioritization_{name}.png", attributes)
        print(name, rated.tally.report()["layers"]["wfpi_x"], rated.tally.report()["share_changed_by_satellites"])


if __name__ == "__main__":
    main()
