"""The process of the arrival service: looks of satellites in, fire arrival maps out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import AwareDatetime, Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    import pandas as pd

    from services.arrival.gathering import Tables
    from services.arrival.publish import FireResult, FireTask

Format = Literal["pictures", "animation", "geotiff", "kml", "wrfxweb", "onnx"]
ALL_FORMATS: tuple[Format, ...] = ("pictures", "animation", "geotiff", "kml", "wrfxweb")


class InferFireArrivalInputs(ProcessInputs):
    detections: ArtifactRef | list[ArtifactRef] = Field(
        description="active-fire detections and looks that saw no fire: detections tables (Parquet), granules of VIIRS "
        "(VNP14IMG, VJ114IMG; netCDF) or MODIS (MOD14, MYD14; HDF4), FIRMS CSV, HMS text or Parquet; one or a list"
    )
    burned_area: list[ArtifactRef] = Field([], description="burned_area tables of the GNSS-R retrieval")
    incidents: ArtifactRef = Field(description="incidents table; a Point is the place of ignition")
    perimeters: list[ArtifactRef] = Field(
        [], description="perimeters tables: outlines with the time at which the fire had them; they bound the map"
    )
    ignitions: list[ArtifactRef] = Field(
        [], description="known ignition points: tables of the perimeters contract with Point geometries"
    )
    weather: ArtifactRef | None = Field(
        None, description="weather grid (CF netCDF) or table (Parquet) for the next 24 hours; null: spread alone"
    )
    wrfinput: ArtifactRef | None = Field(
        None, description="wrfinput-like netCDF whose fire subgrid TIGN_G is written on; null: no TIGN_G"
    )
    simulation_start: AwareDatetime | None = Field(None, description="start of the WRF-SFIRE simulation; null: `start`")
    simulation_end: AwareDatetime | None = Field(None, description="end of the WRF-SFIRE simulation; null: `end`")
    start: AwareDatetime = Field(description="start of the period; earlier data is ignored")
    end: AwareDatetime = Field(description="end of the period; later data is ignored")
    cell_m: float = Field(500.0, ge=30, le=5000, description="cell of the map, m")
    margin_km: float = Field(10.0, ge=1, le=50, description="margin of the map around the detections, km")
    method: Literal[
        "arrival-posterior", "arrival-field", "fusion-nn", "svm", "nearest-detection", "fusion-nn-paper"
    ] = Field(
        "arrival-posterior",
        description="smooth field with the likelihood of every look, corrected by a network that learned from "
        "simulated fires; the field alone; the paper's network (also by its former name, the last); the published "
        "support vector machine; the plain baseline",
    )
    min_confidence: float = Field(70.0, ge=0, le=100, description="a fire row needs a higher confidence; null passes")
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of the networks")
    epochs: int | None = Field(
        None, ge=1, le=5000, description="training epochs (the field's: of ten steps each); null: the method's own"
    )
    ensemble: int | None = Field(None, ge=1, le=32, description="members of the field; null: its own")
    formats: list[Format] = Field(
        list(ALL_FORMATS),
        description="what is made beside the netCDF and the GeoJSON isochrones; onnx: the network of fusion-nn",
    )


class InferFireArrivalOutputs(ProcessOutputs):
    fire_arrival: list[ArtifactRef] = Field(description="netCDF per incident, fire_arrival_<incident_id>.nc")
    maps: list[ArtifactRef] = Field(description="PNG per incident: arrival under isochrones, detections over it")
    isochrones: ArtifactRef = Field(description="GeoJSON of all incidents, times in UTC")
    report: ArtifactRef = Field(description="JSON: counts, flags, and the plain baseline beside the method")
    incident_count: int = Field(description="incidents mapped")
    information_maps: list[ArtifactRef] = Field(
        [], description="PNG per incident: no pass, hidden by cloud, no fire seen and how long ago, fire seen"
    )
    front_maps: list[ArtifactRef] = Field([], description="PNG per incident: where the fire may arrive within 24 h")
    animations: list[ArtifactRef] = Field([], description="GIF per incident in which anything burned")
    geotiffs: list[ArtifactRef] = Field(
        [], description="Cloud-Optimised GeoTIFFs per incident: fire_arrival_<id>.tif and information_<id>.tif"
    )
    isochrones_kml: list[ArtifactRef] = Field([], description="KML per incident, an isochrone with its time span each")
    networks: list[ArtifactRef] = Field([], description="ONNX per incident, where asked for, of fusion-nn")
    wrfxweb: ArtifactRef | None = Field(None, description="manifest of wrfxweb; its pictures lie beside it")
    tign_g: ArtifactRef | None = Field(None, description="netCDF with TIGN_G on the fire subgrid of `wrfinput`")


def _settings(inputs: InferFireArrivalInputs) -> Any:
    from services.arrival.inference import own_settings, quick

    return quick(own_settings(inputs.method), inputs.epochs, inputs.ensemble)


def _tasks(inputs: InferFireArrivalInputs, tables: Tables, context: JobContext) -> tuple[list[FireTask], int]:
    """One task a fire, and how many fire detections belong to none."""
    from services.arrival.assignment import assign
    from services.arrival.gathering import cases_of, read_weather, weather_of
    from services.arrival.publish import FireTask
    from services.arrival.sight import paint_passes

    assignment = assign(tables.detections, tables.incidents)
    weather = read_weather(inputs, context)
    settings = _settings(inputs)
    attributes = {**context.product_attributes(), "method": inputs.method}
    tasks = []
    for case in cases_of(tables, assignment, inputs):
        passes = paint_passes(tables.detections, tables.obscured, case.grid, case.reference, case.end_h)
        there, notes = weather_of(weather, case, tables.end)
        tasks.append(
            FireTask(
                case, inputs.method, inputs.seed, settings, passes, there, attributes, tuple(inputs.formats), notes
            )
        )
    return tasks, len(assignment.unassigned)


def _stage(context: JobContext, result: FireResult) -> dict[str, ArtifactRef]:
    """Put a fire's files into the staging folder."""
    for name, content in result.files.items():
        context.new_file(name).write_bytes(content)
    return {name: context.ref(name) for name in result.files}


def _stamped(context: JobContext) -> dict[str, Any]:
    return {f"smokeglint_{key}": value for key, value in context.product_attributes().items()}


def _write_isochrones(context: JobContext, results: list[FireResult]) -> ArtifactRef:
    import json

    features = [feature for result in results for feature in result.features]
    collection = {"type": "FeatureCollection", "features": features, **_stamped(context)}
    text = json.dumps(collection, sort_keys=True, allow_nan=False)
    context.new_file("isochrones.geojson").write_text(text + "\n", encoding="utf-8")
    return context.ref("isochrones.geojson")


def _write_tign_g(
    inputs: InferFireArrivalInputs, context: JobContext, tasks: list[FireTask], results: list[FireResult]
) -> ArtifactRef | None:
    if inputs.wrfinput is None:
        return None
    import pandas as pd

    from services.arrival.exports.wrf_sfire import read_subgrid, tign_g, write_tign_g

    def utc(moment: Any) -> pd.Timestamp:
        return pd.Timestamp(moment).tz_convert("UTC")

    subgrid = read_subgrid(context.path(inputs.wrfinput), inputs.wrfinput.name)
    start, end = utc(inputs.simulation_start or inputs.start), utc(inputs.simulation_end or inputs.end)
    fires = [(result.arrival, task.case.reference) for task, result in zip(tasks, results, strict=True)]
    values, outside_s = tign_g(fires, subgrid, start, end)
    path = context.new_file("tign_g.nc")
    write_tign_g(path, values, subgrid, start, outside_s, context.product_attributes())
    return context.ref("tign_g.nc")


def _write_wrfxweb(inputs: InferFireArrivalInputs, context: JobContext, results: list[FireResult]) -> Any:
    import json

    from services.arrival.exports.wrfxweb import manifest

    if "wrfxweb" not in inputs.formats:
        return None
    content = manifest([result.web for result in results if result.web])
    context.new_file("wrfxweb_manifest.json").write_text(json.dumps(content, sort_keys=True, indent=1) + "\n")
    return context.ref("wrfxweb_manifest.json")


def infer_fire_arrival(inputs: InferFireArrivalInputs, context: JobContext) -> InferFireArrivalOutputs:
    """Map every incident known by `end` from the looks that belong to it, each fire on its own."""
    from services.arrival.gathering import gather_tables
    from services.arrival.publish import run_fire
    from shared.fan_out import fan_out_in_turn

    context.progress(1, "reading the looks")
    tables = gather_tables(inputs, context)
    tasks, unassigned = _tasks(inputs, tables, context)
    results: list[FireResult] = []
    files: dict[str, ArtifactRef] = {}
    context.progress(5, f"mapping {len(tasks)} fires")
    for done, result in enumerate(fan_out_in_turn(run_fire, [(task,) for task in tasks]), start=1):
        results.append(result)
        files |= _stage(context, result)
        name = tasks[done - 1].case.name
        context.progress(5 + 88 * done / len(tasks), f"mapped {name}, {done} of {len(tasks)} fires")
    report = {
        "method": inputs.method,
        "end": tables.end.isoformat(),
        "counts": {**tables.counts, "detections_unassigned": unassigned},
        "files": tables.files,
        "incidents": [result.report for result in results],
    }
    tign = _write_tign_g(inputs, context, tasks, results)
    web = _write_wrfxweb(inputs, context, results)
    return _outputs(files, _write_isochrones(context, results), context.write_json("report.json", report), web, tign)


def _outputs(
    files: dict[str, ArtifactRef], isochrones: ArtifactRef, report: ArtifactRef, web: Any, tign: Any
) -> InferFireArrivalOutputs:
    def of(prefix: str, suffix: str) -> list[ArtifactRef]:
        return [ref for name, ref in files.items() if name.startswith(prefix) and name.endswith(suffix)]

    return InferFireArrivalOutputs(
        fire_arrival=of("fire_arrival_", ".nc"),
        maps=of("fire_arrival_", ".png"),
        isochrones=isochrones,
        report=report,
        incident_count=len(of("fire_arrival_", ".nc")),
        information_maps=of("information_", ".png"),
        front_maps=of("front24_", ".png"),
        animations=of("fire_arrival_", ".gif"),
        geotiffs=of("", ".tif"),
        isochrones_kml=of("isochrones_", ".kml"),
        networks=of("network_", ".onnx"),
        wrfxweb=web,
        tign_g=tign,
    )


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.arrival.gathering",
    "services.arrival.publish",
    "services.arrival.figures.animation",
    "services.arrival.figures.information_map",
    "shared.contracts.tables",
)

PROCESSES = [
    Process(
        id="infer-fire-arrival",
        title="Fire arrival time from scattered looks",
        description="When the fire reached every place, with its uncertainty, from active-fire detections, looks "
        "that saw no fire and burned-area points; and where it may arrive within the next 24 hours.",
        inputs=InferFireArrivalInputs,
        outputs=InferFireArrivalOutputs,
        run=infer_fire_arrival,
    )
]
