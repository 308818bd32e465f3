"""A map for people: arrival time under its isochrones and the detections, and where nobody looked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd

from services.arrival.extent import NOT_SEEN
from services.arrival.inference import ArrivalMap
from services.arrival.isochrones import levels
from services.arrival.looks import Looks

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patheffects import withStroke


def footer(attributes: Mapping[str, Any]) -> str:
    """What the map rests on, in a line."""
    simulated = "SIMULATED input" if attributes.get("simulated") else "no simulated input"
    share = f" ({100 * float(attributes.get('simulated_share', 0)):.0f} %)" if attributes.get("simulated") else ""
    oldest = attributes.get("oldest_input") or "not stated"
    return f"{simulated}{share} · oldest input {oldest} · code {attributes.get('code_version', '')}"


def _clock(reference: pd.Timestamp, hours: float) -> str:
    return (reference + pd.Timedelta(hours=hours)).tz_convert("UTC").strftime("%d %b %H:%M")


def _frame(axes: Axes, lon: np.ndarray, lat: np.ndarray, shown: np.ndarray) -> None:
    pad_lat = 0.04
    pad_lon = pad_lat / max(np.cos(np.radians(lat.mean())), 0.1)
    axes.set_xlim(max(lon[shown].min() - pad_lon, lon.min()), min(lon[shown].max() + pad_lon, lon.max()))
    axes.set_ylim(max(lat[shown].min() - pad_lat, lat.min()), min(lat[shown].max() + pad_lat, lat.max()))
    axes.set_aspect(1 / np.cos(np.radians(lat.mean())))
    axes.set_xlabel("longitude (degrees east)")
    axes.set_ylabel("latitude (degrees north)")
    axes.locator_params(nbins=6)
    axes.grid(color="0.85", linewidth=0.5)


def _detections(axes: Axes, arrival: ArrivalMap, looks: Looks) -> None:
    east, north = arrival.grid.origin_km
    for chosen, style in (
        (looks.fire, {"s": 1.5, "color": "black", "alpha": 0.45, "label": "active-fire detection"}),
        (
            looks.take((looks.kind == 2) & (looks.probability >= 0.5)),
            {"s": 26, "facecolors": "none", "edgecolors": "#1f4e9c", "label": "burned (GNSS-R)"},
        ),
    ):
        if len(chosen):
            lon, lat = arrival.grid.degrees((chosen.x_km + east) * 1e3, (chosen.y_km + north) * 1e3)
            axes.scatter(np.unwrap(lon, period=360), lat, linewidths=0.6, zorder=4, **style)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower left", fontsize=8, framealpha=0.9, markerscale=3)


def draw_map(
    path: Path, arrival: ArrivalMap, looks: Looks, reference: pd.Timestamp, name: str, attributes: Mapping[str, Any]
) -> None:
    """Write the PNG: colours for arrival (UTC), labelled isochrones, detections, grey where there was no look."""
    figure, axes = plt.subplots(figsize=(9.0, 7.0), dpi=110, layout="constrained")
    try:
        x, y = np.meshgrid(arrival.grid.x_m, arrival.grid.y_m)
        lon, lat = arrival.grid.degrees(x, y)
        lon = np.where(lon - lon[0, 0] > 180, lon - 360, np.where(lon - lon[0, 0] < -180, lon + 360, lon))
        hidden = np.ma.masked_where(arrival.evidence.information != NOT_SEEN, np.ones(x.shape))
        axes.pcolormesh(lon, lat, hidden, cmap=ListedColormap(["0.88"]), shading="nearest")
        burned = np.isfinite(arrival.arrival_h)
        if burned.any():
            _arrival(figure, axes, arrival, lon, lat, reference)
        _frame(axes, lon, lat, burned if burned.any() else np.ones(x.shape, bool))
        _detections(axes, arrival, looks)
        title = f"Fire arrival time, {name}: {burned.sum() * (arrival.grid.cell_m / 1e3) ** 2:.0f} km² burned"
        axes.set_title(title + (f"\nmind: {', '.join(arrival.flags)}" if arrival.flags else ""), fontsize=12)
        figure.supxlabel("grey: no look · " + footer(attributes), fontsize=7, color="0.35")
        figure.savefig(path, metadata={"Software": None})
    finally:
        plt.close(figure)


def _arrival(
    figure: Any, axes: Axes, arrival: ArrivalMap, lon: np.ndarray, lat: np.ndarray, reference: pd.Timestamp
) -> None:
    hours = np.ma.masked_invalid(arrival.arrival_h)
    mesh = axes.pcolormesh(lon, lat, hours, cmap="YlOrRd_r", shading="nearest", zorder=2)
    ticks = levels(arrival.arrival_h, reference, most=8)
    bar = figure.colorbar(mesh, ax=axes, shrink=0.85, ticks=ticks)
    bar.ax.set_yticklabels([_clock(reference, float(tick)) for tick in ticks], fontsize=8)
    bar.set_label("arrival time (UTC)")
    if min(hours.shape) > 1 and ticks.size > 1 and float(hours.max()) > float(hours.min()):
        lines = axes.contour(lon, lat, hours, levels=ticks[:-1], colors="0.25", linewidths=0.7, zorder=3)
        labels = axes.clabel(lines, fmt=lambda level: _clock(reference, float(level)), fontsize=8)
        for label in labels:
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
            label.set_zorder(5)
