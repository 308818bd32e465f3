"""The processes of the prioritization service."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import AwareDatetime, Field

from services.prioritization.fire_weather.processes import FIRE_WEATHER_PROCESSES
from services.prioritization.prefire_processes import PREFIRE_PROCESSES
from shared.artifacts.reference import ArtifactRef
from shared.process import JobContext, Process, ProcessInputs, ProcessOutputs

MODEL = "large-fire-victoria-loop-2"


class RateActiveFiresInputs(ProcessInputs):
    incidents: ArtifactRef = Field(description="incidents table")
    weather: ArtifactRef = Field(description="hourly weather: grid (netCDF) or weather table (Parquet)")
    time: AwareDatetime = Field(description="cut-off; the 24 h after it are rated, nothing issued later is used")
    fuels: ArtifactRef | None = Field(
        None, description="fuels grid with kbdi in mm (and annual_rain_mm, elevation_m); else KBDI is imputed"
    )
    fuel_moisture: ArtifactRef | None = Field(None, description="forecast-fuel-moisture grid; else 1.28 x equilibrium")
    model: ArtifactRef | None = Field(None, description="model of train-large-fire-model; else the shipped one")


class RateActiveFiresOutputs(ProcessOutputs):
    ratings: ArtifactRef
    report: ArtifactRef
    rated: int


def rate_active_fires(inputs: RateActiveFiresInputs, context: JobContext) -> RateActiveFiresOutputs:
    """Probability of becoming large, with interval, percentile and reasons, of every incident known at ``time``."""
    from services.prioritization import sources
    from services.prioritization.large_fire import model as large_fire_model
    from services.prioritization.large_fire import rating

    time = sources.to_utc(inputs.time)
    incidents: Any = context.read_table(inputs.incidents, "INCIDENTS")
    known = incidents[incidents["known_at"] <= time].reset_index(drop=True)
    series_at, flagged = sources.weather_series(context.path(inputs.weather), time)
    context.progress(30, "weather read")
    model_path = context.path(inputs.model) if inputs.model else large_fire_model.shipped_path()
    model = large_fire_model.load(model_path)
    fuels = context.path(inputs.fuels) if inputs.fuels else None
    drought, height = sources.drought_at(fuels, series_at, time), sources.elevation_at(fuels)
    moisture = sources.fuel_moisture_at(context.path(inputs.fuel_moisture) if inputs.fuel_moisture else None)
    conditions = rating.burning_conditions(known, series_at, time, drought, moisture, model.calibration.median, height)
    ratings = rating.rate(known, conditions, model, time)
    report = {
        "time": time.isoformat(),
        "rated": len(ratings),
        "incidents_not_yet_known": sorted(incidents.loc[incidents["known_at"] > time, "incident_id"]),
        "weather_values_taken_out": flagged,
        "imputed": {row.incident_id: row.imputed for row in ratings.itertuples() if row.imputed},
        "outside_training": {
            row.incident_id: row.outside_training for row in ratings.itertuples() if row.out_of_domain
        },
        "base_rate": model.calibration.base_rate,
        "model_trained_on": f"{model.calibration.fires} fires, {model.calibration.label}",
    }
    return RateActiveFiresOutputs(
        ratings=context.write_table("ratings.parquet", ratings, "RATINGS"),
        report=context.write_json("report.json", report),
        rated=len(ratings),
    )


class ForecastFuelMoistureInputs(ProcessInputs):
    weather: ArtifactRef = Field(description="hourly weather grid (netCDF), past and forecast hours")
    time: AwareDatetime = Field(description="cut-off: later observations and weather issued later are not used")
    observations: ArtifactRef | None = Field(
        None, description="Parquet: time, place, fuel_moisture_10h_pct, optionally fuel_moisture_sd_pct (per cent)"
    )


class ForecastFuelMoistureOutputs(ProcessOutputs):
    fuel_moisture: ArtifactRef
    report: ArtifactRef
    observations_used: int


def forecast_fuel_moisture(inputs: ForecastFuelMoistureInputs, context: JobContext) -> ForecastFuelMoistureOutputs:
    """1-, 10- and 100-h dead fuel moisture with variance, every hour of the weather, corrected by stations."""
    import numpy as np

    from services.prioritization import fuel_moisture, fuel_moisture_grid, sources
    from shared.contracts import grids

    time = sources.to_utc(inputs.time)
    weather = sources.weather_grid(context.path(inputs.weather), time)
    stations = sources.station_table(context.path(inputs.observations)) if inputs.observations else None
    result = fuel_moisture.forecast(weather, stations, time)
    context.progress(70, "written")
    grid = fuel_moisture_grid.to_dataset(result, weather)
    grids.write_netcdf(context.new_file("fuel_moisture.nc"), grid, context.product_attributes())
    report = {
        "time": time.isoformat(),
        "hours": len(weather.time),
        "observations_used": result.used,
        "observations_refused": result.refused,
        "weather_values_taken_out": weather.flagged,
        "sd_10h_pct_at_end": float(np.nanmean(result.variance[-1, 1]) ** 0.5),
        "hours_ahead": float((weather.time[-1] - np.datetime64(time.tz_localize(None), "ns")) / np.timedelta64(1, "h")),
        "cells_without_weather": int((result.hours_without_weather == len(weather.time)).sum()),
        "cells_with_gaps": int((result.hours_without_weather > 0).sum()),
    }
    return ForecastFuelMoistureOutputs(
        fuel_moisture=context.ref("fuel_moisture.nc"),
        report=context.write_json("report.json", report),
        observations_used=result.used,
    )


class TrainLargeFireModelInputs(ProcessInputs):
    table: ArtifactRef = Field(description="fires with weather and outcome: CSV, CSV.gz or Parquet")
    label: str = Field("uncontrolled_within_100_ha", description="column of the outcome, 0 or 1 (1: became large)")
    season_column: str = Field("season", description="column of the fire season (texts that sort in time) or region")
    columns: Literal["loop", "full", "us"] = Field(
        "loop", description="loop: what every case carries; full: with land (Victoria); us: the US table's"
    )
    first_test_season: str = Field("2013-14", description="first season of the rolling-origin test")
    validation: Literal["rolling-origin", "leave-one-out"] = Field(
        "rolling-origin", description="rolling-origin: by season, earlier ones teach; leave-one-out: by region"
    )
    ablation: bool = Field(False, description="also test with fewer feature groups (some ten times the work)")
    source: str = Field("Victorian Wildfire Research Dataset 2.5.8", description="where the table is from")
    seed: int = Field(0, ge=0, description="seed of the trees and of the resampling")


class TrainLargeFireModelOutputs(ProcessOutputs):
    model: ArtifactRef
    calibration: ArtifactRef
    card: ArtifactRef
    report: ArtifactRef
    figure: ArtifactRef
    auc: float
    mcc: float
    brier_skill: float


def train_large_fire_model(inputs: TrainLargeFireModelInputs, context: JobContext) -> TrainLargeFireModelOutputs:
    """Train, calibrate and test the large-fire model; the UBJ file carries its calibration."""
    from dataclasses import asdict

    from services.prioritization import sources
    from services.prioritization.large_fire import card, figures, training

    table = sources.fire_table(context.path(inputs.table))
    trained = training.train_and_test(
        table,
        inputs.label,
        inputs.season_column,
        inputs.columns,
        design=inputs.validation,
        first_season=inputs.first_test_season,
        ablation=inputs.ablation,
        seed=inputs.seed,
        progress=context.progress,
    )
    trained.model.save(context.new_file("large_fire.ubj"))
    text = card.write(trained.model.calibration, trained.skill, inputs.source)
    context.new_file("large_fire.md").write_text(text, encoding="utf-8")
    figures.draw(trained.skill, context.new_file("large_fire.png"), context.product_attributes())
    return TrainLargeFireModelOutputs(
        model=context.ref("large_fire.ubj"),
        calibration=context.write_json("large_fire.json", asdict(trained.model.calibration)),
        card=context.ref("large_fire.md"),
        report=context.write_json("report.json", trained.skill),
        figure=context.ref("large_fire.png"),
        auc=trained.skill["auc"],
        mcc=trained.skill["mcc"],
        brier_skill=trained.skill["brier_skill"],
    )


class BuildTargetsInputs(ProcessInputs):
    incidents: ArtifactRef = Field(description="incidents table")
    ratings: ArtifactRef = Field(description="ratings table of rate-active-fires")
    danger: ArtifactRef = Field(description="danger grid of rate-prefire-danger")
    area: tuple[float, float, float, float] = Field(description="west, south, east, north in degrees")
    time: AwareDatetime = Field(description="cut-off; nothing known later is used")
    detections: ArtifactRef | None = Field(None, description="detections table")
    fire_arrival: list[ArtifactRef] = Field([], description="fire arrival maps (netCDF), one per incident")
    burned_area: list[ArtifactRef] = Field([], description="burned area tables")
    observed: ArtifactRef | None = Field(
        None, description="Parquet of good observations: longitude_deg, latitude_deg, time"
    )
    previous_ratings: ArtifactRef | None = Field(
        None, description="ratings table of the last cycle, to say what changed; else earlier rows of ratings"
    )
    previous_report: ArtifactRef | None = Field(
        None, description="report of the last build-targets, to say how ranks and places changed"
    )
    horizon_h: float = Field(24, gt=0, le=192, description="how far ahead to look, hours")
    active_spacing_km: float = Field(5, ge=0.5, le=99, description="spacing of active targets, km")
    prefire_spacing_deg: float = Field(0.1, ge=0.005, le=5, description="spacing of pre-fire targets, degrees")


class BuildTargetsOutputs(ProcessOutputs):
    targets: ArtifactRef
    report: ArtifactRef
    active_count: int
    prefire_count: int


def build_targets(inputs: BuildTargetsInputs, context: JobContext) -> BuildTargetsOutputs:
    """Active and pre-fire targets on one reward scale, staleness and feedback included, and why each fire ranks so."""
    from services.prioritization import lattice, situation_files, targets

    situation = situation_files.read(inputs, context)
    danger = situation_files.read_danger(context.path(inputs.danger))
    context.progress(30, "inputs read")
    active = lattice.Lattice("active", inputs.active_spacing_km)
    prefire = lattice.Lattice("prefire", inputs.prefire_spacing_deg)
    frame, report = targets.build(situation, danger, active, prefire)
    return BuildTargetsOutputs(
        targets=context.write_table("targets.parquet", frame, "TARGETS"),
        report=context.write_json("report.json", report),
        active_count=report["active_targets"],
        prefire_count=report["prefire_targets"],
    )


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.prioritization.fuel_moisture_grid",
    "services.prioritization.large_fire.rating",
    "services.prioritization.prefire.danger_map",
    "services.prioritization.targets",
    "shared.contracts.tables",
)

PROCESSES = [
    Process(
        id="rate-active-fires",
        title="Rate active fires",
        description="Calibrated probability that each incident becomes a large fire: interval, percentile, drivers.",
        inputs=RateActiveFiresInputs,
        outputs=RateActiveFiresOutputs,
        run=rate_active_fires,
        model_version=MODEL,
    ),
    *PREFIRE_PROCESSES,
    Process(
        id="forecast-fuel-moisture",
        title="Forecast dead fuel moisture",
        description="1-, 10- and 100-h dead fuel moisture with variance by a time-lag model and Kalman filter.",
        inputs=ForecastFuelMoistureInputs,
        outputs=ForecastFuelMoistureOutputs,
        run=forecast_fuel_moisture,
    ),
    Process(
        id="build-targets",
        title="Build targets",
        description="Active and pre-fire targets on one reward scale, with staleness and what earlier cycles saw.",
        inputs=BuildTargetsInputs,
        outputs=BuildTargetsOutputs,
        run=build_targets,
    ),
    Process(
        id="train-large-fire-model",
        title="Train the large-fire model",
        description="Train, calibrate and test the model of rate-active-fires on a table of fires with outcomes.",
        inputs=TrainLargeFireModelInputs,
        outputs=TrainLargeFireModelOutputs,
        run=train_large_fire_model,
    ),
    *FIRE_WEATHER_PROCESSES,
]
