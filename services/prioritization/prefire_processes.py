"""The pre-fire processes: rating the danger grid, and refitting the probabilities behind it."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import AwareDatetime, Field

from shared.artifacts.reference import ArtifactRef
from shared.process import JobContext, Process, ProcessInputs, ProcessOutputs

FPI_VERSION = "FPI edition: 2000 (live ratio from maximum NDVI) or 1998 (from loads)"
GRID = (
    "fuels: the fuels' own grid; usgs-1km: the USGS's whole 1 km grid of the United States; usgs-1km-window: its cells "
    "around the fuels. On 1 km the result is rasters (COG), and the danger grid holds their means over 0.1 degrees"
)
DEMONSTRATION = "wlfp-wfsp-demonstration-2"
Raster = Literal["wfpi", "wlfp", "wfsp", "change"]


class RatePrefireDangerInputs(ProcessInputs):
    weather: ArtifactRef = Field(description="hourly weather grid (netCDF), best to 192 h after the time")
    fuels: ArtifactRef = Field(
        description="fuels grid (netCDF, or GeoTIFF on the USGS grid): ndvi and extremes, loads, extinction, mask codes"
    )
    time: AwareDatetime = Field(description="cut-off and start of lead day 0; nothing known later is used")
    soil_moisture: list[ArtifactRef] = Field([], description="soil moisture tables of the satellites")
    burned_area: list[ArtifactRef] = Field([], description="burned area tables of the satellites")
    fuel_moisture: ArtifactRef | None = Field(None, description="forecast-fuel-moisture grid; else 1.28 x equilibrium")
    fpi_version: Literal["2000", "1998"] = Field("2000", description=FPI_VERSION)
    soil_moisture_resolution_km: Literal[9, 36] = Field(9, description="EASE-Grid cell of the soil moisture tables, km")
    grid: Literal["fuels", "usgs-1km", "usgs-1km-window"] = Field("fuels", description=GRID)
    lead_days: int = Field(8, ge=1, le=8, description="how many lead days, from day 0 on")
    rasters: list[Raster] = Field(["wfpi", "wlfp", "wfsp", "change"], description="which rasters of a 1 km grid")
    probability_model: ArtifactRef | None = Field(
        None, description="model of fit-fire-probability; else the shipped demonstration"
    )


class RatePrefireDangerOutputs(ProcessOutputs):
    danger: ArtifactRef
    map: ArtifactRef
    report: ArtifactRef
    change_map: ArtifactRef
    rasters: list[ArtifactRef]
    share_changed: float


def rate_prefire_danger(inputs: RatePrefireDangerInputs, context: JobContext) -> RatePrefireDangerOutputs:
    """WFPI, WLFP and WFSP of the lead days, without and with soil moisture and burned area."""
    from dataclasses import replace

    from services.prioritization import sources
    from services.prioritization.prefire import conditions, danger, danger_run, fire_probability

    time = sources.to_utc(inputs.time)
    given = danger_run.read_fuels(context.path(inputs.fuels))
    fuels = danger_run.on_grid(given, inputs.grid)
    weather = sources.weather_grid(context.path(inputs.weather), time)
    context.progress(20, "weather and fuels read")
    moisture = sources.fuel_moisture_grid(context.path(inputs.fuel_moisture)) if inputs.fuel_moisture else None
    daily = conditions.daily_conditions(weather, moisture, time, inputs.lead_days)
    effects = danger.DangerEffects()
    if inputs.probability_model:
        model = fire_probability.from_document(context.read_json(inputs.probability_model))
        effects = replace(effects, probability=model)
    soil: Any = [context.read_table(ref, "SOIL_MOISTURE") for ref in inputs.soil_moisture]
    burned: Any = [context.read_table(ref, "BURNED_AREA") for ref in inputs.burned_area]
    seen = danger.seen_land(fuels.grid, soil, burned, time, effects, inputs.soil_moisture_resolution_km)
    context.progress(40, "danger")
    rated = danger_run.rate(fuels, daily, seen, time, inputs.fpi_version, effects, inputs.rasters)
    return _write(rated, fuels, daily, effects, weather.flagged, time, context)


def _write(
    rated: Any, fuels: Any, daily: Any, effects: Any, flagged: dict[str, int], time: Any, context: JobContext
) -> RatePrefireDangerOutputs:
    """The danger grid, the rasters, the two maps and the report."""
    from services.prioritization.prefire import danger_map, danger_product, danger_run
    from shared.contracts import grids

    attributes = context.product_attributes()
    grids.write_netcdf(context.new_file("danger.nc"), grids.DANGER.check(rated.grid), attributes)
    context.progress(60, "rasters")
    stated = danger_product.global_attributes(time, {"fpi_version": rated.grid.attrs["fpi_version"], **attributes})
    rasters = danger_run.write_rasters(rated, context.new_file, stated)
    context.progress(85, "maps")
    note = " · ".join(f"{name.replace('_', ' ')} {value}" for name, value in sorted(fuels.notes.items()))
    picture = danger_map.picture_of(rated, note)
    danger_map.draw(picture, context.new_file("danger.png"), attributes)
    danger_map.draw_changes(picture, context.new_file("change.png"), attributes)
    report = _report(rated, fuels, daily, effects.probability, {"weather_values_taken_out": flagged})
    report["time"] = time.isoformat()
    return RatePrefireDangerOutputs(
        danger=context.ref("danger.nc"),
        map=context.ref("danger.png"),
        report=context.write_json("report.json", report),
        change_map=context.ref("change.png"),
        rasters=[context.ref(name) for name in rasters],
        share_changed=report["share_changed_by_satellites"],
    )


def _report(rated: Any, fuels: Any, daily: Any, probability: Any, weather: dict[str, Any]) -> dict[str, Any]:
    return {
        "grid": {"kind": fuels.grid.kind, "crs": fuels.grid.crs, "shape": fuels.grid.shape},
        **rated.tally.report(),
        **weather,
        "vegetation_values_taken_out": dict(fuels.counts),
        "share_of_moisture_from_forecast": daily.forecast_share,
        "soil_moisture_percentiles_of": fuels.notes.get("soil_moisture_years", "years not stated by the fuels grid"),
        "ndvi_extremes_of": fuels.notes.get("ndvi_years", "years not stated by the fuels grid"),
        "fire_probability": probability.trained_on,
        "demonstration": _demonstration(probability.demonstration),
    }


def _demonstration(demonstration: bool) -> str:
    if demonstration:
        return "WLFP and WFSP use demonstration coefficients, refitted to a simulated fire history"
    return "WLFP and WFSP use a refit of the caller's"


class FitFireProbabilityInputs(ProcessInputs):
    fires: ArtifactRef = Field(
        description="fires of an acre or more (Parquet or CSV): longitude_deg, latitude_deg, time, wfpi, large|area_km2"
    )
    voxels: ArtifactRef = Field(
        description="km2-days: longitude_deg, latitude_deg, time, wfpi, ignition, sampling_rate; large to test WLFP"
    )
    source: str = Field(description="where the tables are from, kept in the model")
    demonstration: bool = Field(False, description="true if the tables are made up")


class FitFireProbabilityOutputs(ProcessOutputs):
    model: ArtifactRef
    report: ArtifactRef
    figure: ArtifactRef
    bins_held: int
    bins: int


def fit_fire_probability(inputs: FitFireProbabilityInputs, context: JobContext) -> FitFireProbabilityOutputs:
    """Refit WFSP and WLFP, and hold left-out years against the USGS's reliability bins."""
    from services.prioritization.prefire import fire_probability, fire_probability_fit, fire_probability_skill

    read = fire_probability_fit.read_table
    fires = fire_probability_fit.checked_fires(read(context.path(inputs.fires), "fires"))
    voxels = fire_probability_fit.checked_voxels(read(context.path(inputs.voxels), "voxels"))
    if inputs.demonstration:
        context.mark_simulated()
    refit = fire_probability_fit.fit(fires, voxels, inputs.source, inputs.demonstration)
    context.progress(50, "fitted")
    report = fire_probability_skill.against_usgs(refit, fires, voxels)
    fire_probability_skill.draw(report, context.new_file("reliability.png"), context.product_attributes())
    summary = report["summary"].values()
    return FitFireProbabilityOutputs(
        model=context.write_json("fire_probability.json", fire_probability.to_document(refit.model)),
        report=context.write_json("report.json", {"fires": len(fires), "voxels": len(voxels), **report}),
        figure=context.ref("reliability.png"),
        bins_held=sum(part["bins_held"] for part in summary),
        bins=sum(part["bins"] for part in summary),
    )


PREFIRE_PROCESSES = [
    Process(
        id="rate-prefire-danger",
        title="Rate pre-fire danger",
        description="WFPI, WLFP and WFSP of lead days 0-7, with and without satellite soil moisture and burned area.",
        inputs=RatePrefireDangerInputs,
        outputs=RatePrefireDangerOutputs,
        run=rate_prefire_danger,
        model_version=DEMONSTRATION,
    ),
    Process(
        id="fit-fire-probability",
        title="Refit large-fire probability",
        description="WFSP and WLFP by logistic regression smooth in place, day and WFPI; tested in the USGS's bins.",
        inputs=FitFireProbabilityInputs,
        outputs=FitFireProbabilityOutputs,
        run=fit_fire_probability,
    ),
]
