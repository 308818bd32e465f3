"""The drawing of the priority map: one panel, the fires that matter named, the rest in five steps of colour."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import geopandas
import matplotlib
import numpy as np
import pandas as pd
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from pyproj import Transformer

from shared.figures import save
from shared.process import JobContext

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from flows.steps.priority_map import PriorityMapInputs

matplotlib.use("Agg")
STATES = Path(__file__).parent / "us_states.geojson"
ALBERS = 5070  # CONUS Albers: areas are true
LISTED = 12
SHADES = ListedColormap(["#f7f3e3", "#f3d9a4", "#e8a860", "#c9662f", "#7f2a14"])
LEVELS = (0.0, 0.2, 0.4, 0.6, 0.8)  # quantiles of the reachable places' rewards
OUT_OF_REACH = "#d9dcdf"
PROBABILITY = ListedColormap(["#fee08b", "#fdae61", "#f46d43", "#d73027", "#67001f"])
CLASSES = (0.0, 0.03, 0.06, 0.12, 0.25, 1.0)


@dataclass(frozen=True)
class Layers:
    """``prefire``: targets with ``reachable``; ``fires``: incidents by probability, with rank and ``reachable``."""

    prefire: geopandas.GeoDataFrame
    fires: pd.DataFrame


def read_layers(inputs: PriorityMapInputs, context: JobContext) -> Layers:
    """Targets, and the rated incidents in order."""
    targets = context.read_table(inputs.targets, "TARGETS")
    seen = set(context.read_table(inputs.opportunities, "OPPORTUNITIES")["target_id"])
    targets = targets.assign(reachable=targets["target_id"].isin(seen))
    active = targets[targets["kind"] == "active"]
    reached = set(active.loc[active["reachable"], "source"].str.removeprefix("incident:"))
    fires = context.read_table(inputs.incidents, "INCIDENTS")
    rated = context.read_table(inputs.ratings, "RATINGS")[["incident_id", "probability"]]
    fires = fires.merge(rated, on="incident_id", how="left").fillna({"probability": 0.0})
    fires = fires.sort_values(["probability", "incident_id"], ascending=[False, True], ignore_index=True)
    fires = fires.assign(
        rank=np.arange(1, len(fires) + 1),
        simulated=fires["simulated"].astype(bool) if "simulated" in fires else False,
        reachable=fires["incident_id"].isin(reached),
        longitude_deg=fires.geometry.representative_point().x.round(4),
        latitude_deg=fires.geometry.representative_point().y.round(4),
        probability=fires["probability"].round(4),
    )
    return Layers(targets[targets["kind"] == "prefire"], pd.DataFrame(fires.drop(columns="geometry")))


def listed(fires: pd.DataFrame) -> pd.DataFrame:
    """The fires that are named: the likeliest real ones, and simulated ones only where there is room left."""
    return fires.sort_values(["simulated", "rank"]).head(LISTED).assign(place=lambda f: np.arange(1, len(f) + 1))


def draw(layers: Layers, inputs: PriorityMapInputs, path: Path, product: dict[str, Any]) -> None:
    """The map with its legend, the list of fires, and what was simulated in the footer."""
    figure = Figure(figsize=(14.5, 8.2))
    axes = figure.add_axes((0.005, 0.04, 0.76, 0.85))
    edges = _draw_prefire(axes, layers)
    _draw_states(axes)
    _draw_fires(axes, layers)
    _frame(axes, layers)
    name, _, made_of = inputs.title.partition(": ")
    figure.text(0.015, 0.955, name, fontsize=16, weight="bold")
    made_of += "; ratings and rewards are not those of that day" if product["simulated"] else ""
    figure.text(0.015, 0.89, made_of.capitalize(), fontsize=9.5, color="#b30000" if product["simulated"] else "dimgrey")
    simulated = int(layers.fires["simulated"].sum())
    heading = f"Observation priorities for 24 h from {inputs.cutoff:%Y-%m-%d %H:%M} UTC"
    known = f"{len(layers.fires) - simulated} fires known by then" + (f", {simulated} simulated" if simulated else "")
    figure.text(0.015, 0.92, f"{heading}. {known}.", fontsize=11)
    _list_fires(figure, layers)
    _legend(figure, edges)
    save(figure, path, product)


def _xy(longitude: Any, latitude: Any) -> tuple[Any, Any]:
    x, y = Transformer.from_crs(4326, ALBERS, always_xy=True).transform(longitude, latitude)
    return np.asarray(x) / 1000, np.asarray(y) / 1000


def _draw_prefire(axes: Axes, layers: Layers) -> list[float]:
    """Pre-fire places as small squares; gives the edges of the colours."""
    places = layers.prefire
    x, y = _xy(places.geometry.x.to_numpy(), places.geometry.y.to_numpy())
    near = places["reachable"].to_numpy()
    axes.scatter(x[~near], y[~near], s=5.2, marker="s", c=OUT_OF_REACH, linewidths=0, rasterized=True)
    values = places["priority"].to_numpy()[near]
    if not len(values):
        return []
    edges = sorted({float(edge) for edge in np.quantile(values, LEVELS)})
    shade = SHADES(np.clip(np.searchsorted(edges, values, side="right") - 1, 0, SHADES.N - 1))
    axes.scatter(x[near], y[near], s=5.2, marker="s", c=shade, linewidths=0, rasterized=True)
    return edges


def _draw_states(axes: Axes) -> None:
    lines = json.loads(STATES.read_text(encoding="utf-8"))["features"][0]["geometry"]["coordinates"]
    drawn = [np.stack(_xy(*np.array(line).T), axis=1) for line in lines]
    axes.add_collection(LineCollection(drawn, colors="#5b6770", linewidths=0.6))


def _draw_fires(axes: Axes, layers: Layers) -> None:
    norm = BoundaryNorm(CLASSES, PROBABILITY.N)
    fires = layers.fires.iloc[::-1]  # the likeliest on top
    x, y = _xy(fires["longitude_deg"].to_numpy(), fires["latitude_deg"].to_numpy())
    size = 26 + 190 * np.sqrt(fires["probability"].to_numpy())
    colours = PROBABILITY(norm(fires["probability"].to_numpy()))
    made = fires["simulated"].to_numpy()
    axes.scatter(x[made], y[made], s=size[made], c=colours[made], marker="D", edgecolors="#3b82c4", linewidths=1.1)
    axes.scatter(x[~made], y[~made], s=size[~made], c=colours[~made], marker="o", edgecolors="black", linewidths=0.9)
    for row in listed(layers.fires).itertuples():
        at = _xy(row.longitude_deg, row.latitude_deg)
        text = axes.annotate(str(row.place), at, xytext=(7, 6), textcoords="offset points", fontsize=9, weight="bold")
        text.set_bbox({"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75})


def _frame(axes: Axes, layers: Layers) -> None:
    """The extent of the pre-fire places, with a margin of 60 km."""
    x, y = _xy(layers.prefire.geometry.x.to_numpy(), layers.prefire.geometry.y.to_numpy())
    if len(x):
        axes.set(xlim=(x.min() - 60, x.max() + 60), ylim=(y.min() - 60, y.max() + 60))
    axes.set_aspect("equal")
    axes.axis("off")


def _list_fires(figure: Figure, layers: Layers) -> None:
    left, top, step = 0.775, 0.885, 0.0325
    figure.text(left, top + 0.022, "Fires: chance of becoming large", fontsize=11, weight="bold")
    for number, row in enumerate(listed(layers.fires).itertuples()):
        y = top - 0.012 - step * number
        name = str(row.name)[:22] + (" *" if row.simulated else "") + ("" if row.reachable else " †")
        figure.text(left, y, f"{row.place:>2}", fontsize=10, family="monospace")
        figure.text(left + 0.022, y, name, fontsize=10, color="#3b82c4" if row.simulated else "black")
        figure.text(0.985, y, f"{100 * row.probability:.0f} %", fontsize=10, ha="right")
    notes = "* simulated, listed after the real ones\n† out of reach in these 24 h"
    figure.text(left, top - 0.022 - step * LISTED, notes, fontsize=8, va="top")


def _legend(figure: Figure, edges: list[float]) -> None:
    fires = [
        Line2D([], [], ls="", marker="o", mec="black", mfc="white", ms=8, label="fire, real"),
        Line2D([], [], ls="", marker="D", mec="#3b82c4", mfc="white", ms=7, label="fire, simulated"),
    ]
    fires += [
        Line2D([], [], ls="", marker="o", mec="grey", mfc=PROBABILITY(k), ms=9, label=f"{100 * a:.0f}–{100 * b:.0f} %")
        for k, (a, b) in enumerate(pairwise(CLASSES))
    ]
    common = {"bbox_transform": figure.transFigure, "frameon": False, "fontsize": 8.5, "alignment": "left"}
    figure.legend(handles=fires, title="Probability of becoming large", loc="upper left",
                  bbox_to_anchor=(0.765, 0.440), ncols=2, **common)  # fmt: skip
    spans = [f"{low:.3f}–{high:.3f}" for low, high in pairwise(edges)] + [f"{low:.3f} and more" for low in edges[-1:]]
    places = [Patch(fc=SHADES(k), ec="grey", lw=0.4, label=span) for k, span in enumerate(spans)]
    places.append(Patch(fc=OUT_OF_REACH, ec="grey", lw=0.4, label="no pass covers it"))
    places.append(Patch(fc="white", ec="grey", lw=0.4, label="no pre-fire place"))
    figure.legend(handles=places, title="Pre-fire reward (fifths of the places in reach)", loc="upper left",
                  bbox_to_anchor=(0.765, 0.285), ncols=1, **common)  # fmt: skip
