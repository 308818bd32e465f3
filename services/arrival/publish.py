"""Everything that one fire yields, as one pure step: its map, its next day, and the files made of them.

The step takes and gives plain values, so that many fires can run side by side on other processes or machines.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from services.arrival.exports.geotiff import write_arrival_geotiff, write_sight_geotiff
from services.arrival.exports.isochrones import isochrone_features
from services.arrival.exports.kml import isochrone_kml
from services.arrival.exports.product import iso, to_dataset
from services.arrival.exports.wrfxweb import domain_entries
from services.arrival.fires import FireCase, case_report, map_case
from services.arrival.front.forecast import Front, forecast_front
from services.arrival.front.weather import HourlyWeather
from services.arrival.inference import ArrivalMap
from services.arrival.metrics import mean_error_h, sorensen
from services.arrival.paper_method import PaperSettings, fit_paper
from services.arrival.sight import Passes, Sight, sight_of
from shared.contracts.grids import FIRE_ARRIVAL, write_netcdf

LONGEST_STEM = 120


@dataclass(frozen=True)
class FireTask:
    """One fire to map: its case, how, and what its files say of themselves. `notes` become flags of the product."""

    case: FireCase
    method: str
    seed: int
    settings: Any
    passes: Passes
    weather: HourlyWeather | None
    attributes: Mapping[str, Any]
    formats: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FireResult:
    """What a fire gave: files by name, in the order of the kinds that made them, and what goes into common files."""

    arrival: ArrivalMap
    files: dict[str, bytes]
    features: list[dict[str, Any]]
    web: dict[str, Any]
    report: dict[str, Any]


def stem_of(case: FireCase) -> str:
    """The incident's name in file names. One that a file name cannot carry as it is ends in a digest of itself, so
    that two such incidents never share a file."""
    plain = re.sub(r"[^A-Za-z0-9._-]", "_", case.incident_id)[:LONGEST_STEM]
    if plain == case.incident_id:
        return plain
    return f"{plain}-{hashlib.sha256(case.incident_id.encode()).hexdigest()[:8]}"


def _against_baseline(case: FireCase, arrival: ArrivalMap) -> dict[str, float | None]:
    """How far the method lies from the plain baseline: a large figure is a reason to look at the map."""
    plain = map_case(case, "nearest-detection", 0)
    difference, shift = mean_error_h(arrival.arrival_h, plain.arrival_h)
    overlap = sorensen(np.isfinite(arrival.arrival_h), np.isfinite(plain.arrival_h))
    return {"mean_difference_h": difference, "mean_shift_h": shift, "sorensen": overlap}


def _pictures(folder: Path, task: FireTask, arrival: ArrivalMap, front: Front, sight: Sight) -> None:
    from services.arrival.figures.animation import draw_animation
    from services.arrival.figures.arrival_map import draw_map
    from services.arrival.figures.front_map import draw_front
    from services.arrival.figures.information_map import draw_information

    case, attributes, stem = task.case, task.attributes, stem_of(task.case)
    if "pictures" in task.formats:
        draw_map(folder / f"fire_arrival_{stem}.png", arrival, case.looks, case.reference, case.name, attributes)
        draw_information(folder / f"information_{stem}.png", case, arrival, sight, attributes)
        draw_front(folder / f"front24_{stem}.png", case, arrival, front, attributes)
    if "animation" in task.formats:
        path = folder / f"fire_arrival_{stem}.gif"
        draw_animation(path, arrival, case.looks, case.reference, case.name, attributes)


def _grids(folder: Path, task: FireTask, arrival: ArrivalMap, front: Front, sight: Sight) -> None:
    case, stem = task.case, stem_of(task.case)
    stated = {**task.attributes, "end": iso(case.reference + pd.Timedelta(hours=case.end_h))}
    dataset = to_dataset(arrival, case.reference, case.incident_id, stated, sight, front.probability)
    write_netcdf(folder / f"fire_arrival_{stem}.nc", FIRE_ARRIVAL.check(dataset))
    if "geotiff" in task.formats:
        tags = {**task.attributes, "incident_id": case.incident_id, "reference_time": iso(case.reference)}
        write_arrival_geotiff(folder / f"fire_arrival_{stem}.tif", arrival, front.probability, tags)
        write_sight_geotiff(folder / f"information_{stem}.tif", sight, arrival.grid, tags)


def _network(folder: Path, task: FireTask, arrival: ArrivalMap) -> None:
    """The paper's network of this fire as ONNX: fitted again, which gives the same network."""
    if "onnx" not in task.formats or not isinstance(task.settings, PaperSettings) or not arrival.parameters:
        return
    from services.arrival.exports.onnx_model import export_network

    fitted = fit_paper(task.case.looks, task.settings, task.seed)
    export_network(folder / f"network_{stem_of(task.case)}.onnx", fitted)


def _front_report(front: Front, arrival: ArrivalMap) -> dict[str, Any]:
    cell_km2 = (arrival.grid.cell_m / 1e3) ** 2
    likely = (front.probability >= 0.5).sum() * cell_km2
    return {
        "basis": front.basis,
        "expected_km2": round(float(front.probability.sum()) * cell_km2, 3),
        "likely_km2": round(float(likely), 3),
    }


def run_fire(task: FireTask) -> FireResult:
    """Map one fire and make its files. Deterministic in the task."""
    from dataclasses import replace

    case = task.case
    arrival = map_case(case, task.method, task.seed, task.settings)
    arrival = replace(arrival, flags=tuple(dict.fromkeys((*arrival.flags, *task.notes))))
    front = forecast_front(arrival, case.end_h, task.weather)
    sight = sight_of(arrival, task.passes)
    features = isochrone_features(arrival, case.reference, case.incident_id)
    stem = stem_of(case)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        _grids(folder, task, arrival, front, sight)
        _pictures(folder, task, arrival, front, sight)
        _network(folder, task, arrival)
        linked = {}
        if "kml" in task.formats:
            text = isochrone_kml(features, {case.incident_id: case.name}, task.attributes)
            (folder / f"isochrones_{stem}.kml").write_text(text, encoding="utf-8")
            linked["kml"] = f"isochrones_{stem}.kml"
        if "geotiff" in task.formats:
            linked["tiff"] = f"fire_arrival_{stem}.tif"
        web = {}
        if "wrfxweb" in task.formats:
            web = domain_entries(arrival, case.reference, stem, lambda name: folder / name, linked)
        files = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    report = {
        **case_report(case, arrival),
        "front24": _front_report(front, arrival),
        "beside_nearest_detection": _against_baseline(case, arrival),
    }
    return FireResult(arrival, files, features, web, report)
