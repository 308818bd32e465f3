"""The map of arrival: colours for time under labelled isochrones and detections, grey where nobody looked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patheffects import withStroke

from services.arrival.exports.isochrones import levels
from services.arrival.extent import NOT_SEEN
from services.arrival.figures.axes import Place, clock, draw_detections, finish, new_map, place_of
from services.arrival.inference import ArrivalMap
from services.arrival.looks import Looks


def draw_map(
    path: Path, arrival: ArrivalMap, looks: Looks, reference: pd.Timestamp, name: str, attributes: Mapping[str, Any]
) -> None:
    """Write the PNG: arrival (UTC) in colours, isochrones, detections, grey where there was no look."""
    place = place_of(arrival)
    burned = np.isfinite(arrival.arrival_h)
    figure, axes = new_map(place, burned if burned.any() else np.ones(burned.shape, bool))
    hidden = np.ma.masked_where(arrival.evidence.information != NOT_SEEN, np.ones(burned.shape))
    axes.pcolormesh(place.longitude, place.latitude, hidden, cmap=ListedColormap(["0.88"]), shading="nearest")
    axes.grid(color="0.85", linewidth=0.5)
    if burned.any():
        _arrival(axes, arrival, place, reference)
    draw_detections(axes, arrival, looks, place)
    title = f"Fire arrival time, {name}: {burned.sum() * (arrival.grid.cell_m / 1e3) ** 2:.0f} km² burned"
    weak = f"mind: {', '.join(arrival.flags)}" if arrival.flags else "grey: no look"
    axes.set_title(f"{title}\n{weak}", fontsize=12)
    finish(figure, path, attributes)


def _arrival(axes: Axes, arrival: ArrivalMap, place: Place, reference: pd.Timestamp) -> None:
    hours = np.ma.masked_invalid(arrival.arrival_h)
    mesh = axes.pcolormesh(place.longitude, place.latitude, hours, cmap="YlOrRd_r", shading="nearest", zorder=2)
    ticks = levels(arrival.arrival_h, reference, most=8)
    bar = axes.figure.colorbar(mesh, ax=axes, shrink=0.85, ticks=ticks)
    bar.ax.set_yticklabels([clock(reference, float(tick)) for tick in ticks], fontsize=8)
    bar.set_label("arrival time (UTC)")
    if min(hours.shape) > 1 and ticks.size > 1 and float(hours.max()) > float(hours.min()):
        lines = axes.contour(
            place.longitude, place.latitude, hours, levels=ticks[:-1], colors="0.25", linewidths=0.7, zorder=3
        )
        labels = axes.clabel(lines, fmt=lambda level: clock(reference, float(level)), fontsize=8)
        for label in labels:
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
            label.set_zorder(5)
