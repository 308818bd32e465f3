"""The process of the arrival service: looks of satellites in, fire arrival maps out."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Literal

from pydantic import AwareDatetime, Field

from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd

    from services.arrival.fires import FireCase
    from services.arrival.inference import ArrivalMap


class InferFireArrivalInputs(ProcessInputs):
    detections: ArtifactRef = Field(description="detections table: active-fire detections and looks that saw no fire")
    burned_area: list[ArtifactRef] = Field([], description="burned_area tables of the GNSS-R retrieval")
    incidents: ArtifactRef = Field(description="incidents table; a Point is the place of ignition")
    start: AwareDatetime = Field(description="start of the period; earlier data is ignored")
    end: AwareDatetime = Field(description="end of the period; later data is ignored")
    cell_m: float = Field(500.0, ge=30, le=5000, description="cell of the map, m")
    margin_km: float = Field(10.0, ge=1, le=50, description="margin of the map around the detections, km")
    method: Literal["fusion-nn", "fusion-nn-paper", "nearest-detection"] = Field(
        "fusion-nn", description="network with the likelihood of every look; the paper's network; the plain baseline"
    )
    min_confidence: float = Field(70.0, ge=0, le=100, description="a fire row needs a higher confidence; null passes")
    seed: int = Field(0, ge=0, le=2**31 - 1, description="seed of the networks")
    epochs: int | None = Field(
        None, ge=1, le=5000, description="training epochs (fusion-nn: of ten minibatches each); null: the method's own"
    )
    ensemble: int | None = Field(None, ge=1, le=32, description="networks in the ensemble of fusion-nn; null: its own")


class InferFireArrivalOutputs(ProcessOutputs):
    fire_arrival: list[ArtifactRef] = Field(description="netCDF per incident, fire_arrival_<incident_id>.nc")
    maps: list[ArtifactRef] = Field(description="PNG per incident")
    isochrones: ArtifactRef = Field(description="GeoJSON of all incidents, times in UTC")
    report: ArtifactRef = Field(description="JSON: counts, flags, and the plain baseline beside the method")
    incident_count: int = Field(description="incidents mapped")


def _tables(
    inputs: InferFireArrivalInputs, context: JobContext
) -> tuple[gpd.GeoDataFrame, gpd.GeoDataFrame, gpd.GeoDataFrame, pd.Timestamp, dict[str, int]]:
    import geopandas as gpd
    import pandas as pd

    from services.arrival.fires import within
    from services.arrival.looks import confident

    start, end = pd.Timestamp(inputs.start).tz_convert("UTC"), pd.Timestamp(inputs.end).tz_convert("UTC")
    read = context.read_table(inputs.detections, "DETECTIONS")
    period = within(read, start, end)
    detections = confident(period, inputs.min_confidence).reset_index(drop=True)
    parts = [context.read_table(reference, "BURNED_AREA") for reference in inputs.burned_area]
    filled = [within(part, start, end) for part in parts if len(part)]
    empty = gpd.GeoDataFrame({"time": pd.Series(dtype="datetime64[ms, UTC]")}, geometry=gpd.GeoSeries([], crs=4326))
    burned_area = gpd.GeoDataFrame(pd.concat(filled, ignore_index=True), crs=4326) if filled else empty
    incidents = context.read_table(inputs.incidents, "INCIDENTS")
    known = incidents[(incidents["known_at"] <= end) & (incidents["start"] <= end)].reset_index(drop=True)
    counts = {
        "detections_read": len(read),
        "detections_outside_period": len(read) - len(period),
        "detections_low_confidence": len(period) - len(detections),
        "incidents_not_yet_known": len(incidents) - len(known),
    }
    return detections, burned_area, known, end, counts


def _settings(inputs: InferFireArrivalInputs) -> Any:
    from services.arrival.field import FieldSettings
    from services.arrival.inference import quick
    from services.arrival.paper_method import PaperSettings

    own = PaperSettings() if inputs.method == "fusion-nn-paper" else FieldSettings()
    return quick(own, inputs.epochs, inputs.ensemble)


def _publish(case: FireCase, arrival: ArrivalMap, context: JobContext, method: str) -> tuple[ArtifactRef, ArtifactRef]:
    from services.arrival.exports.product import to_dataset
    from services.arrival.figures.arrival_map import draw_map
    from shared.contracts.grids import FIRE_ARRIVAL, write_netcdf

    stem = re.sub(r"[^A-Za-z0-9._-]", "_", case.incident_id)
    attributes = {**context.product_attributes(), "method": method}
    dataset = FIRE_ARRIVAL.check(to_dataset(arrival, case.reference, case.incident_id, attributes))
    write_netcdf(context.new_file(f"fire_arrival_{stem}.nc"), dataset)
    draw_map(context.new_file(f"fire_arrival_{stem}.png"), arrival, case.looks, case.reference, case.name, attributes)
    return context.ref(f"fire_arrival_{stem}.nc"), context.ref(f"fire_arrival_{stem}.png")


def _against_baseline(case: FireCase, arrival: ArrivalMap) -> dict[str, float | None]:
    """How far the method lies from the plain baseline: a large figure is a reason to look at the map."""
    import numpy as np

    from services.arrival.fires import map_case
    from services.arrival.metrics import mean_error_h, sorensen

    plain = map_case(case, "nearest-detection", 0)
    difference, shift = mean_error_h(arrival.arrival_h, plain.arrival_h)
    overlap = sorensen(np.isfinite(arrival.arrival_h), np.isfinite(plain.arrival_h))
    return {"mean_difference_h": difference, "mean_shift_h": shift, "sorensen": overlap}


def infer_fire_arrival(inputs: InferFireArrivalInputs, context: JobContext) -> InferFireArrivalOutputs:
    """Map every incident known by `end` from the looks that belong to it."""
    import json

    from services.arrival.assignment import assign
    from services.arrival.exports.isochrones import isochrone_features
    from services.arrival.fires import build_case, case_report, map_case

    detections, burned_area, incidents, end, counts = _tables(inputs, context)
    assignment = assign(detections, incidents)
    settings = _settings(inputs)
    products, maps, features, reports = [], [], [], []
    for index, incident in incidents.iterrows():
        context.progress(5 + 90 * float(index) / len(incidents), f"fire arrival of {incident['name']}")
        case = build_case(
            incident, detections, burned_area, assignment, end, inputs.cell_m, inputs.margin_km, inputs.seed
        )
        arrival = map_case(case, inputs.method, inputs.seed, settings)
        product, picture = _publish(case, arrival, context, inputs.method)
        products.append(product)
        maps.append(picture)
        features += isochrone_features(arrival, case.reference, case.incident_id)
        reports.append({**case_report(case, arrival), "beside_nearest_detection": _against_baseline(case, arrival)})
    path = context.new_file("isochrones.geojson")
    collection = {
        "type": "FeatureCollection",
        "features": features,
        **{f"smokeglint_{k}": v for k, v in context.product_attributes().items()},
    }
    path.write_text(json.dumps(collection, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")
    counts = {**counts, "detections_unassigned": len(assignment.unassigned)}
    report = context.write_json(
        "report.json", {"method": inputs.method, "end": end.isoformat(), "counts": counts, "incidents": reports}
    )
    return InferFireArrivalOutputs(
        fire_arrival=products,
        maps=maps,
        isochrones=context.ref("isochrones.geojson"),
        report=report,
        incident_count=len(products),
    )


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.arrival.fires",
    "services.arrival.exports.isochrones",
    "services.arrival.figures.arrival_map",
    "shared.contracts.tables",
)

PROCESSES = [
    Process(
        id="infer-fire-arrival",
        title="Fire arrival time from scattered looks",
        description="When the fire reached every place, with its uncertainty, from active-fire detections, looks "
        "that saw no fire and burned-area points.",
        inputs=InferFireArrivalInputs,
        outputs=InferFireArrivalOutputs,
        run=infer_fire_arrival,
    )
]
