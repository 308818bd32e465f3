"""The processes of the retrieval service. Heavy imports wait for the worker."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from services.retrieval import process_files as files
from services.retrieval import process_models as models
from shared.process import ArtifactRef, JobContext, Process

if TYPE_CHECKING:
    import geopandas

MODEL_PATH = Path(__file__).parent / "models" / "burned_area.ubj"


def simulate_observations(
    inputs: models.SimulateObservationsInputs, context: JobContext
) -> models.SimulateObservationsOutputs:
    """Play the satellites on a simulated surface."""
    from services.retrieval.looks.observation_report import data_volume
    from services.retrieval.simulation import observations
    from services.retrieval.simulation.surface import read_surface

    context.mark_simulated(share=1.0)
    points = context.read_table(inputs.specular_points, "SPECULAR_POINTS")
    surface = read_surface(str(context.path(inputs.surface)))
    attributes = context.product_attributes()
    refs: dict[str, ArtifactRef] = {}
    report: dict[str, Any] = {}
    seconds = {"nominal": 0, "raw_if": 0}
    if inputs.nominal:
        context.progress(15, "nominal maps")
        made = observations.simulate_nominal(points, surface, inputs.seed)
        made.write(context.new_file("nominal.nc"), attributes)
        refs["nominal"], report["nominal"] = context.ref("nominal.nc"), made.summary()
        seconds["nominal"] = made.satellite_seconds()
    images, left_out = files.observed_images(inputs, context)
    if images is not None and len(images):
        context.progress(60, "raw-IF maps")
        made = observations.simulate_raw_if(points, images, surface, inputs.seed)
        made.write(context.new_file("raw_if.nc"), attributes)
        refs["raw_if"], report["raw_if"] = context.ref("raw_if.nc"), made.summary() | {"images": len(images)}
        seconds["raw_if"] = made.satellite_seconds()
    report |= {"images_left_out": left_out, "data_volume": data_volume(*seconds.values())}
    return models.SimulateObservationsOutputs(
        **refs,
        report=context.write_json("report.json", report),
        nominal_count=report.get("nominal", {}).get("maps", 0),
        raw_if_count=report.get("raw_if", {}).get("maps", 0),
    )


def retrieve_burned_area(
    inputs: models.RetrieveBurnedAreaInputs, context: JobContext
) -> models.RetrieveBurnedAreaOutputs:
    """Burned probability of every usable look."""
    from services.retrieval.burned_area import model as burned_area
    from services.retrieval.burned_area import products as burned_products
    from services.retrieval.burned_area.perimeters import read_perimeters
    from services.retrieval.looks.observation_report import observation_report, screening_attribute
    from shared.contracts import schema, tables

    seen = files.looks_with_ancillary(inputs, context)
    baseline = None if inputs.baseline is None else files.read_plain(inputs.baseline, context)
    perimeters = None if inputs.perimeters is None else read_perimeters(context.path(inputs.perimeters))
    context.progress(60, "classifying")
    model = burned_area.load_model(MODEL_PATH if inputs.model is None else context.path(inputs.model))
    features = burned_area.feature_table(seen.looks, baseline)
    table = burned_products.burned_area_table(seen.looks, model.probability(features), model)
    attributes = files.burned_area_product(inputs, context) | screening_attribute(seen.screening)
    path = files.new_file("burned_area.parquet", context, attributes)
    schema.write_table(path, table, tables.BURNED_AREA, attributes)
    context.progress(80, "maps")
    refs = _burned_maps(table, model.threshold, perimeters, attributes, context)
    burned = int(table["burned"].sum())
    report = observation_report(seen) | {
        "threshold": model.threshold,
        "with_baseline": int(features["change_db"].notna().sum()),
        "burned": burned,
        "looks": len(table),
    }
    return models.RetrieveBurnedAreaOutputs(
        burned_area=context.ref("burned_area.parquet"),
        report=context.write_json("report.json", report),
        **refs,
        look_count=len(table),
        burned_count=burned,
    )


def _burned_maps(
    table: geopandas.GeoDataFrame,
    threshold: float,
    perimeters: geopandas.GeoDataFrame | None,
    attributes: dict[str, Any],
    context: JobContext,
) -> dict[str, ArtifactRef]:
    """The EASE-Grid map (netCDF, COG), the GeoJSON and the picture, by output name."""
    from services.retrieval.burned_area import products as burned_products
    from shared.contracts.grids import write_netcdf

    grid = burned_products.burned_area_grid(table, threshold)
    names = {"grid": "burned_area.nc", "cog": "burned_area.tif", "geojson": "burned_area.geojson"}
    paths = {output: files.new_file(name, context, attributes) for output, name in names.items()}
    names["map"] = "burned_area.png"
    drawn = context.product_attributes() | {"screening": attributes["screening"]}
    write_netcdf(paths["grid"], grid, attributes)
    burned_products.write_burned_cog(paths["cog"], grid, attributes)
    burned_products.write_burned_geojson(paths["geojson"], table, attributes)
    burned_products.burned_area_map(table, context.new_file(names["map"]), drawn, threshold, perimeters)
    return {output: context.ref(name) for output, name in names.items()}


def retrieve_soil_moisture(
    inputs: models.RetrieveSoilMoistureInputs, context: JobContext
) -> models.RetrieveSoilMoistureOutputs:
    """Daily soil moisture of the reference's cells."""
    from services.retrieval.looks.observation_report import observation_report, screening_attribute
    from services.retrieval.soil_moisture import level3, quantiles, regression
    from shared.contracts import schema, tables
    from shared.contracts.grids import write_netcdf

    seen = files.read_looks(inputs, context)
    context.progress(60, "regression")
    reference = files.read_plain(inputs.reference, context)
    model = None if inputs.raw_if_model is None else quantiles.load_raw_if(context.path(inputs.raw_if_model))
    table, counts = regression.retrieve(seen.looks, reference, None if model is None else model.interval)
    resolution_km = regression.grid_of(reference)
    grid = level3.level3_grid(table, resolution_km)
    screened = {**seen.screening, "cell_days": counts}
    attributes = context.product_attributes() | screening_attribute(screened)
    schema.write_table(context.new_file("soil_moisture.parquet"), table, tables.SOIL_MOISTURE, attributes)
    write_netcdf(context.new_file("soil_moisture.nc"), grid, attributes)
    level3.write_level3_cog(context.new_file("soil_moisture.tif"), grid, attributes)
    raw_if = "regression" if model is None else model.method
    settings = {"cell_days": len(table), "resolution_km": resolution_km, "raw_if_by": raw_if}
    return models.RetrieveSoilMoistureOutputs(
        soil_moisture=context.ref("soil_moisture.parquet"),
        grid=context.ref("soil_moisture.nc"),
        cog=context.ref("soil_moisture.tif"),
        report=context.write_json("report.json", observation_report(seen) | counts | settings),
        cell_count=len(table),
    )


def train_burned_area(inputs: models.TrainBurnedAreaInputs, context: JobContext) -> models.TrainBurnedAreaOutputs:
    """Train on some places and times, calibrate on others."""
    from services.retrieval.burned_area import training
    from services.retrieval.looks.observation_report import observation_report, screening_attribute

    seen = files.looks_with_ancillary(inputs, context)
    places = None if inputs.labels is None else training.read_labels(context.path(inputs.labels))
    rasters = [files.read_burned_raster(given, context) for given in inputs.burned_rasters]
    label = training.union_labels(seen.looks, places, rasters)
    baseline = None if inputs.baseline is None else files.read_plain(inputs.baseline, context)
    context.progress(50, "training")
    model, report = training.train_on_looks(seen.looks, label, baseline, inputs.calibration_share)
    screened = {**seen.screening, "labels": {name: report[name] for name in ("looks", "without_label")}}
    model.save(context.new_file("model.ubj"), context.product_attributes() | screening_attribute(screened))
    return models.TrainBurnedAreaOutputs(
        model=context.ref("model.ubj"),
        report=context.write_json("report.json", report | observation_report(seen)),
        look_count=report["looks"],
        auc=report["auc"],
    )


def train_soil_moisture(inputs: models.TrainSoilMoistureInputs, context: JobContext) -> models.TrainSoilMoistureOutputs:
    """Fit the regression of every cell and the raw-IF model, and keep the pre-fire reflectivities."""
    from services.retrieval.looks import baseline
    from services.retrieval.looks.observation_report import observation_report, screening_attribute
    from services.retrieval.soil_moisture import figure, raw_if_training, regression, skill

    seen = files.read_looks(inputs, context)
    truth, resolution_km = files.read_soil_moisture(inputs, context), inputs.resolution_km
    context.progress(60, "regression")
    reference = skill.train_reference(seen.looks, truth, resolution_km)
    slope = float(reference["incidence_slope_db_per_deg"].iloc[0])
    pairs = regression.match(regression.on_grid(seen.looks, resolution_km), truth, slope)
    context.progress(70, "raw-IF model")
    raw_if = raw_if_training.train(seen.looks, reference, truth, inputs.raw_if_method, resolution_km)
    context.progress(80, "skill")
    report = observation_report(seen) | skill.summary(reference, pairs) | {"raw_if": raw_if[1]}
    report |= skill.evaluate(pairs, resolution_km)
    screened = screening_attribute(seen.screening)
    attributes = context.product_attributes() | screened
    files.write_plain("reference.parquet", reference, context, attributes)
    looks_only = files.looks_product(inputs, context) | screened
    files.write_plain("baseline.parquet", baseline.build_baseline(seen.looks), context, looks_only)
    held = skill.with_intervals(skill.leave_days_out(pairs, resolution_km))
    figure.skill_figure(context.new_file("skill.png"), held, attributes)
    if raw_if[0] is not None:
        raw_if[0].save(context.new_file(raw_if[0].file_name), attributes)
    return models.TrainSoilMoistureOutputs(
        reference=context.ref("reference.parquet"),
        baseline=context.ref("baseline.parquet"),
        raw_if_model=None if raw_if[0] is None else context.ref(raw_if[0].file_name),
        figure=context.ref("skill.png"),
        report=context.write_json("report.json", report),
        cell_count=len(reference),
    )


def compute_ddm(inputs: models.ComputeDdmInputs, context: JobContext) -> models.ComputeDdmOutputs:
    """Acquire the reflection and write its 69 x 111 map as a level-1 file of one sample."""
    from services.retrieval.looks.observation_report import screening_attribute
    from services.retrieval.raw_if import acquisition, ddm_product
    from services.retrieval.raw_if.recording import read_recording

    recording = read_recording(context.path(inputs.recording))
    context.progress(10, "acquisition")
    search = inputs.doppler_hz, inputs.milliseconds, inputs.search_hz
    found = acquisition.delay_doppler_map(recording, inputs.prn, inputs.channel, *search)
    screened = screening_attribute({"raw-if": ddm_product.milliseconds(found)})
    path, attributes = context.new_file("ddm.nc"), context.product_attributes() | screened
    known = inputs.look, inputs.noise_temperature_k
    ddm_product.write_ddm(path, found, recording.header, inputs.prn, *known, attributes)
    return models.ComputeDdmOutputs(
        ddm=context.ref("ddm.nc"),
        report=context.write_json("report.json", ddm_product.report(found, recording, path.stat().st_size)),
        peak_to_mean=found.acquired.peak_to_mean,
    )


def _process(run: Any, identifier: str, title: str, description: str, model_version: str = "") -> Process:
    """A declaration whose models are named after the process: simulate-observations, SimulateObservationsInputs."""
    stem = "".join(word.capitalize() for word in identifier.split("-"))
    shapes = getattr(models, f"{stem}Inputs"), getattr(models, f"{stem}Outputs")
    return Process(identifier, title, description, *shapes, run, model_version=model_version)


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.retrieval.burned_area.model",
    "services.retrieval.soil_moisture.level3",
    "services.retrieval.soil_moisture.regression",
    "services.retrieval.simulation.observations",
    "shared.contracts.tables",
)

PROCESSES = [
    _process(
        simulate_observations,
        "simulate-observations",
        "Simulate observations",
        "The satellites' stand-in: delay-Doppler maps of a simulated surface (ambiguity function, coherent and diffuse "
        "scattering, Mironov soil, vegetation, noise, speckle) in level-1 shape. Everything it writes is simulated.",
    ),
    _process(
        retrieve_burned_area,
        "retrieve-burned-area",
        "Retrieve burned area",
        "Burned probability of every land look: reflectivity, shape, texture and change against the place's pre-fire "
        "baseline, by a calibrated XGBoost model; points, EASE-Grid map with counts, GeoJSON and picture.",
        model_version=hashlib.sha256(MODEL_PATH.read_bytes()).hexdigest()[:12],
    ),
    _process(
        retrieve_soil_moisture,
        "retrieve-soil-moisture",
        "Retrieve soil moisture",
        "Daily soil moisture on EASE-Grid 2.0 (9 km) by per-cell regression on reflectivity (UCAR/CU form).",
    ),
    _process(
        train_burned_area,
        "train-burned-area",
        "Train the burned-area model",
        "XGBoost on looks labelled by places or by the union of burned-area rasters (MCD64A1, FireCCI51, Landsat), "
        "split by region and time, with calibrated probability; the model as UBJ.",
    ),
    _process(
        train_soil_moisture,
        "train-soil-moisture",
        "Train soil moisture and the pre-fire baseline",
        "Per-cell regression of soil moisture on reflectivity with partially pooled slopes, its skill beside the cell "
        "mean, and the reflectivity baseline that burned area is judged against.",
    ),
    _process(
        compute_ddm,
        "compute-ddm",
        "Compute a delay-Doppler map",
        "Raw-IF recording to a 69 x 111 map: FFT acquisition against the C/A code, milliseconds summed incoherently.",
    ),
]
