"""The map of a cycle: targets and what was recorded over them beside what burned and when."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import geopandas
import matplotlib
import numpy as np
import pandas as pd
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pyproj import Transformer

from flows.cases.scoring import ArrivalField, polygonal, read_arrival, truth_incidents
from shared.figures import save
from shared.process import JobContext

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from flows.steps.situation import SituationInputs

matplotlib.use("Agg")
_STEP_H = 12
# A legend's distance in its letters: in parts of a flat map it would cover the label of the axis.
_UNDER_MAP: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "borderaxespad": 4.5}


@dataclass(frozen=True)
class Layers:
    """What the map shows, read once."""

    targets: geopandas.GeoDataFrame
    covered_ids: set[int]
    burned: geopandas.GeoDataFrame
    detections: geopandas.GeoDataFrame
    arrivals: list[ArrivalField]
    truths: list[ArrivalField]
    perimeters: geopandas.GeoDataFrame | None


def read_layers(inputs: SituationInputs, context: JobContext) -> Layers:
    """Read the cycle's products; a target is covered if an image over it was collected and not lost."""
    opportunities = context.read_table(inputs.opportunities, "OPPORTUNITIES")
    as_run = context.read_table(inputs.as_run, "AS_RUN")
    good = as_run[as_run["status"] != "lost"]
    images = pd.MultiIndex.from_arrays([good["satellite"], good["start"]])
    seen = pd.MultiIndex.from_arrays([opportunities["satellite"], opportunities["time"]]).isin(images)
    truths = []
    if inputs.truth is not None:
        path = context.path(inputs.truth)
        truths = [read_arrival(path, f"fire_arrival_time_{name}") for name in truth_incidents(path)]
    return Layers(
        targets=context.read_table(inputs.targets, "TARGETS"),
        covered_ids=set(opportunities.loc[seen, "target_id"]),
        burned=context.read_table(inputs.burned_area, "BURNED_AREA"),
        detections=context.read_table(inputs.detections, "DETECTIONS"),
        arrivals=[read_arrival(context.path(reference)) for reference in inputs.fire_arrival],
        truths=truths,
        perimeters=_known_perimeters(inputs, context),
    )


def _known_perimeters(inputs: SituationInputs, context: JobContext) -> geopandas.GeoDataFrame | None:
    if inputs.perimeters is None:
        return None
    table = context.read_table(inputs.perimeters, "PERIMETERS")
    return table[table["known_at"] <= pd.Timestamp(inputs.end)]


def draw(layers: Layers, inputs: SituationInputs, path: Path, product: dict[str, Any]) -> None:
    """Two panels over the region: the plan as it was carried out, and the fires as they are understood."""
    figure = Figure(figsize=(15, 8), layout="constrained")
    left, right = figure.subplots(1, 2)
    when = f"{inputs.cutoff:%Y-%m-%d %H:%M} to {inputs.end:%Y-%m-%d %H:%M} UTC"
    figure.suptitle(f"{inputs.title}\n{when}", fontsize=13)
    _draw_targets(left, layers)
    _draw_fires(figure, right, layers, inputs)
    for axes, box in ((left, inputs.region), (right, _around_fires(layers, inputs.region))):
        west, south, east, north = box
        axes.set(xlim=(west, east), ylim=(south, north), xlabel="longitude (°)", ylabel="latitude (°)")
        axes.set_aspect(1.0 / np.cos(np.radians((south + north) / 2)))
        axes.locator_params(nbins=7)
        axes.grid(alpha=0.2)
    figure.get_layout_engine().set(rect=(0, 0.03, 1, 0.97))  # room for the footer line
    save(figure, path, product)


def _around_fires(layers: Layers, region: tuple[float, float, float, float]) -> tuple[float, ...]:
    """The box about everything that has burned, with a margin of 0.15°; the region where nothing has."""
    corners = []
    for field in layers.arrivals:
        longitude, latitude = _degrees(field)
        burned = np.isfinite(field.arrival_s)
        if burned.any():
            corners.append(
                (*(a[burned].min() for a in (longitude, latitude)), *(a[burned].max() for a in (longitude, latitude)))
            )
    if not corners:
        return region
    boxes = np.array(corners)
    margin = np.array([-0.15, -0.15, 0.15, 0.15])
    return tuple(np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)]) + margin)


def _draw_targets(axes: Axes, layers: Layers) -> None:
    targets = layers.targets
    covered = targets["target_id"].isin(layers.covered_ids)
    active = targets["kind"] == "active"
    styles: list[tuple[Any, dict[str, Any], str]] = [
        (~active & ~covered, {"s": 6, "c": "#c9c9c9", "marker": "s"}, "pre-fire, not recorded"),
        (~active & covered, {"s": 9, "c": "#2b7bba", "marker": "s"}, "pre-fire, recorded"),
        (
            active & ~covered,
            {"s": 34, "facecolors": "none", "edgecolors": "#d7301f", "marker": "o"},
            "active, not recorded",
        ),
        (active & covered, {"s": 34, "c": "#d7301f"}, "active, recorded"),
    ]
    for mask, style, label in styles:
        part = targets[mask]
        axes.scatter(part.geometry.x, part.geometry.y, label=f"{label} ({len(part)})", linewidths=0.8, **style)
    axes.set_title("Targets, and what was recorded in raw-IF mode")
    axes.legend(**_UNDER_MAP, ncols=2, fontsize=8)


def _draw_fires(figure: Figure, axes: Axes, layers: Layers, inputs: SituationInputs) -> None:
    looks = layers.detections
    shown = looks[looks["fire"] & (looks["time"] >= pd.Timestamp(inputs.cutoff))]
    axes.scatter(shown.geometry.x, shown.geometry.y, s=3, c="#fdae61", label="detections of this cycle")
    yes = layers.burned[layers.burned["burned"]]
    axes.scatter(yes.geometry.x, yes.geometry.y, s=10, c="#3f007d", marker="x", label="burned-area points (GNSS-R)")
    handles = axes.get_legend_handles_labels()[0]
    if layers.arrivals:
        _draw_arrival(figure, axes, layers.arrivals, inputs)
    for truth in layers.truths:
        longitude, latitude = _degrees(truth)
        burned = truth.burned_by(inputs.end).astype(float)
        if burned.any():
            axes.contour(longitude, latitude, burned, levels=[0.5], colors="black", linewidths=0.9)
    if layers.truths:
        handles.append(Line2D([], [], color="black", lw=0.9, label="truth of the nature run at the end"))
    if layers.perimeters is not None and len(layers.perimeters):
        outline = layers.perimeters.sort_values("time").groupby("incident_id").tail(1)
        for geometry in outline.geometry:
            geopandas.GeoSeries([polygonal(geometry)]).boundary.plot(ax=axes, color="black", linewidth=0.9)
        handles.append(Line2D([], [], color="black", lw=0.9, label="last mapped perimeter"))
    axes.legend(handles=handles, **_UNDER_MAP, ncols=3, fontsize=8)
    axes.set_title("Fires: arrival time, burned area, detections")


def _draw_arrival(figure: Figure, axes: Axes, arrivals: list[ArrivalField], inputs: SituationInputs) -> None:
    hours = [field.arrival_s / 3600.0 - _hours_before(field, inputs) for field in arrivals]
    oldest = min((float(np.nanmin(h)) for h in hours if np.isfinite(h).any()), default=-_STEP_H)
    edges = np.arange(np.floor(max(oldest, -168) / _STEP_H) * _STEP_H, 0.1, _STEP_H)
    edges = edges if len(edges) > 1 else np.array([-_STEP_H, 0.0])
    norm = BoundaryNorm(edges, 256)
    for field, values in zip(arrivals, hours, strict=True):
        longitude, latitude = _degrees(field)
        shown = np.ma.masked_invalid(np.where(values <= 0, values, np.nan))
        mesh = axes.pcolormesh(longitude, latitude, shown, norm=norm, cmap="YlOrRd", shading="nearest", alpha=0.75)
    figure.colorbar(mesh, ax=axes, shrink=0.7, label="fire arrival, hours before the end of the cycle")


def _hours_before(field: ArrivalField, inputs: SituationInputs) -> float:
    return (inputs.end - field.reference_time).total_seconds() / 3600.0


def _degrees(field: ArrivalField) -> tuple[Any, Any]:
    x, y = np.meshgrid(field.x_m, field.y_m)
    longitude, latitude = Transformer.from_crs(field.crs, 4326, always_xy=True).transform(x, y)
    return longitude, latitude
