"""The process that maps fire weather indices."""

from __future__ import annotations

from pydantic import Field

from shared.artifacts.reference import ArtifactRef
from shared.process import JobContext, Process, ProcessInputs, ProcessOutputs


class MapFireWeatherInputs(ProcessInputs):
    weather: ArtifactRef = Field(
        description="GRIB2 of one time: 2 m temperature and humidity, 10 m wind, orography, and pressure levels"
    )


class MapFireWeatherOutputs(ProcessOutputs):
    indices: ArtifactRef
    map: ArtifactRef
    report: ArtifactRef


def map_fire_weather(inputs: MapFireWeatherInputs, context: JobContext) -> MapFireWeatherOutputs:
    """Haines, HDW, Fosberg, LFP without fuel and 10-h fuel moisture on the weather's grid, as netCDF and PNG."""
    import numpy as np

    from services.prioritization.fire_weather import index_map, upper_air
    from shared.contracts import grids

    air = upper_air.read_grib(context.path(inputs.weather))
    context.progress(40, "weather read")
    grid = index_map.compute(air)
    grids.write_netcdf(context.new_file("indices.nc"), grid, context.product_attributes())
    index_map.draw(grid, context.new_file("indices.png"), context.product_attributes())
    report = {"time": f"{np.datetime_as_string(air.time, unit='s')}Z", "indices": index_map.summary(grid)}
    return MapFireWeatherOutputs(
        indices=context.ref("indices.nc"),
        map=context.ref("indices.png"),
        report=context.write_json("report.json", report),
    )


FIRE_WEATHER_PROCESSES = [
    Process(
        id="map-fire-weather",
        title="Map fire weather indices",
        description="Haines, HDW, Fosberg, LFP and 10-h fuel moisture of one time, from GRIB2 with pressure levels.",
        inputs=MapFireWeatherInputs,
        outputs=MapFireWeatherOutputs,
        run=map_fire_weather,
    )
]
