"""What the maps of one fire share: degrees on the axes, the part that is shown, times in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.arrival.inference import ArrivalMap
from services.arrival.looks import BURNED_AREA, Looks
from shared import figures

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Floats = NDArray[np.float64]
SIZE_IN = (9.0, 7.2)


@dataclass(frozen=True)
class Place:
    """Longitude and latitude (rows, columns), degrees, continuous across the antimeridian."""

    longitude: Floats
    latitude: Floats

    @property
    def middle_longitude(self) -> float:
        return float((self.longitude.mean() + 180.0) % 360.0 - 180.0)


def place_of(arrival: ArrivalMap) -> Place:
    """Where the cells of a map lie."""
    x, y = np.meshgrid(arrival.grid.x_m, arrival.grid.y_m)
    lon, lat = arrival.grid.degrees(x, y)
    first = lon[0, 0]
    return Place(first + (lon - first + 180.0) % 360.0 - 180.0, lat)


def clock(reference: pd.Timestamp, hours: float) -> str:
    """A time in words, UTC."""
    return (reference + pd.Timedelta(hours=hours)).tz_convert("UTC").strftime("%d %b %H:%M")


def solar_clock(time: pd.Timestamp, longitude_deg: float) -> str:
    """Local mean solar time in words: UTC plus four minutes a degree east. Fires keep the sun's time, not a zone's."""
    return (time.tz_convert("UTC") + pd.Timedelta(minutes=4 * longitude_deg)).strftime("%d %b %H:%M")


def new_map(place: Place, shown: NDArray[np.bool_]) -> tuple[Figure, Axes]:
    """A figure whose axes span the shown cells with a margin, in degrees at true proportions."""
    figure, axes = plt.subplots(figsize=SIZE_IN, dpi=110)
    figure.subplots_adjust(left=0.09, right=0.97, bottom=0.11, top=0.89)
    lon, lat = place.longitude, place.latitude
    pad_lat = 0.04
    pad_lon = pad_lat / max(np.cos(np.radians(lat.mean())), 0.1)
    axes.set_xlim(max(lon[shown].min() - pad_lon, lon.min()), min(lon[shown].max() + pad_lon, lon.max()))
    axes.set_ylim(max(lat[shown].min() - pad_lat, lat.min()), min(lat[shown].max() + pad_lat, lat.max()))
    axes.set_aspect(1 / max(np.cos(np.radians(lat.mean())), 0.1))
    axes.set_xlabel("longitude (degrees east)")
    axes.set_ylabel("latitude (degrees north)")
    axes.xaxis.set_major_formatter(lambda value, _: f"{(value + 180.0) % 360.0 - 180.0:.2f}")
    axes.locator_params(nbins=6)
    return figure, axes


def degrees_of(looks: Looks, arrival: ArrivalMap, place: Place) -> tuple[Floats, Floats]:
    """Longitude (continuous with the map's) and latitude of looks (n,), degrees."""
    east, north = arrival.grid.origin_km
    lon, lat = arrival.grid.degrees((looks.x_km + east) * 1e3, (looks.y_km + north) * 1e3)
    first = place.longitude[0, 0]
    return first + (lon - first + 180.0) % 360.0 - 180.0, lat


def draw_detections(axes: Axes, arrival: ArrivalMap, looks: Looks, place: Place) -> None:
    """Active-fire detections as dots and burned-area points of probability over a half as rings, with a legend."""
    ring: dict[str, Any] = {"s": 26, "facecolors": "none", "edgecolors": "#1f4e9c", "label": "burned (GNSS-R, mapped)"}
    burned = looks.take((looks.kind == BURNED_AREA) & (looks.probability >= 0.5))
    dot: dict[str, Any] = {"s": 1.5, "color": "black", "alpha": 0.45, "label": "active-fire detection"}
    for chosen, style in ((looks.fire, dot), (burned, ring)):
        if len(chosen):
            axes.scatter(*degrees_of(chosen, arrival, place), linewidths=0.6, zorder=4, **style)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower left", fontsize=8, framealpha=0.9, markerscale=3)


def finish(figure: Figure, path: Path, attributes: Mapping[str, Any]) -> None:
    """Write the figure with its footer, and let go of it."""
    try:
        figures.save(figure, path, attributes)
    finally:
        plt.close(figure)
