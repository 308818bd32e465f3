"""Index maps of one time: Haines, HDW, Fosberg, LFP without fuel and 10-h fuel moisture, with classes people know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from services.prioritization import indices
from services.prioritization.fire_weather.upper_air import UpperAir
from shared import figures

Array = npt.NDArray[np.float64]

HAINES_BANDS: tuple[tuple[Any, float, tuple[int, int, int]], ...] = (
    ("low", 305.0, (950, 850, 850)),
    ("mid", 914.0, (850, 700, 850)),
    ("high", np.inf, (700, 500, 700)),
)
"""Variant, highest elevation in metres, pressure (hPa) of lower and upper temperature and of the moisture."""
COAST_M = 5.0
COLOURS = ("#4d9221", "#c2e699", "#fee08b", "#f46d43", "#a50026")


@dataclass(frozen=True)
class Classes:
    """Words of an index by rising danger and the values between them; ``origin`` says whose classes they are."""

    title: str
    words: tuple[str, ...]
    breaks: tuple[float, ...]
    origin: str
    falling: bool = False


FIVE = ("low", "moderate", "high", "very high", "extreme")
CLASSES: dict[str, Classes] = {
    "haines": Classes("Haines index", ("very low", "low", "moderate", "high"), (3.5, 4.5, 5.5), "Haines 1988"),
    "hdw": Classes("Hot-Dry-Windy, hPa m/s", FIVE, (50, 100, 200, 350), "this service"),
    "ffwi": Classes("Fosberg fire weather index", FIVE, (20, 35, 50, 65), "this service; 50 as in NWS criteria"),
    "lfp_weather": Classes(
        "LFP without fuel", ("none", "marginal", "moderate", "high", "extreme"), (10, 15, 21, 40), "SAWTI zone 1"
    ),
    "fuel_moisture_10h": Classes(
        "10-h dead fuel moisture, %", FIVE, (18, 12, 8, 5), "this service: low moisture, high danger", True
    ),
}


def haines(air: UpperAir) -> Array:
    """Haines index of each cell by the variant of its elevation; DomainError naming a level that is missing."""
    elevation = air.surface["elevation_m"]
    out = np.full(elevation.shape, np.nan)
    below = -np.inf
    for variant, top, (lower, upper, moist) in HAINES_BANDS:
        here = (elevation >= below) & (elevation < top)
        below = top
        if here.any():
            dew = indices.dew_point_c(air.level(moist, "temperature_c"), air.level(moist, "relative_humidity_pct"))
            value = indices.haines(air.level(lower, "temperature_c"), air.level(upper, "temperature_c"), dew, variant)
            out[here] = value[here]
    return out


def hot_dry_windy(air: UpperAir) -> Array:
    """HDW from the 2 and 10 m weather and the pressure levels within 500 m above ground."""
    names = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s")
    columns = {name: [air.surface[name]] for name in names}
    height = [np.full(air.surface["elevation_m"].shape, 10.0)]
    for pressure in sorted(air.levels, reverse=True):
        level = air.levels[pressure]
        if {*names, "height_m"} <= set(level):
            for name in names:
                columns[name].append(level[name])
            # A level under the ground is no level: its height is negative and the index leaves it out.
            height.append(level["height_m"] - air.surface["elevation_m"])
    stacked = (np.stack(columns[name], axis=-1) for name in names)
    return indices.hot_dry_windy(*stacked, np.stack(height, axis=-1))


def compute(air: UpperAir) -> xr.Dataset:
    """Every index of ``CLASSES`` on the weather's own grid (y, x), latitude and longitude with it; NaN stays NaN."""
    t, rh, wind = (air.surface[n] for n in ("temperature_c", "relative_humidity_pct", "wind_speed_m_s"))
    values = {
        "haines": haines(air),
        "hdw": hot_dry_windy(air),
        "ffwi": indices.fosberg(t, rh, wind),
        "lfp_weather": indices.large_fire_potential(wind, t, rh),
        "fuel_moisture_10h": indices.fuel_moisture_10h_pct(t, rh),
    }
    units = {"hdw": "hPa m s-1", "fuel_moisture_10h": "percent"}
    data: dict[str, Any] = {
        name: (("y", "x"), field, {"long_name": CLASSES[name].title, "units": units.get(name, "1")})
        for name, field in values.items()
    }
    coordinates = {
        "latitude": (("y", "x"), air.latitude_deg, {"units": "degrees_north", "standard_name": "latitude"}),
        "longitude": (("y", "x"), air.longitude_deg, {"units": "degrees_east", "standard_name": "longitude"}),
        "time": air.time,
        "elevation_m": (("y", "x"), air.surface["elevation_m"], {"units": "m", "standard_name": "surface_altitude"}),
    }
    return xr.Dataset(data, coords=coordinates, attrs={"title": "Fire weather indices"})


def classify(values: Array, classes: Classes) -> Array:
    """Class 0 (least danger) and up of each value; NaN stays NaN."""
    if classes.falling:
        inside = len(classes.breaks) - np.digitize(values, classes.breaks[::-1], right=True).astype(np.float64)
    else:
        inside = np.digitize(values, classes.breaks).astype(np.float64)
    return np.where(np.isnan(values), np.nan, inside)


def summary(grid: xr.Dataset) -> dict[str, Any]:
    """Per index: cells in each class, cells without a value, and the largest."""
    out = {}
    for name, classes in CLASSES.items():
        values = grid[name].to_numpy()
        shares = np.bincount(classify(values, classes)[np.isfinite(values)].astype(int), minlength=len(classes.words))
        out[name] = {
            "cells": dict(zip(classes.words, map(int, shares), strict=True)),
            "cells_without_value": int(np.isnan(values).sum()),
            "largest": float(np.nanmax(values)) if np.isfinite(values).any() else None,
            "classes": classes.origin,
        }
    return out


def draw(grid: xr.Dataset, path: Path, attributes: Mapping[str, Any]) -> None:
    """PNG with a panel an index, its legend from low to extreme, and the date; grey where there is no value."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 7.4), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.025, 1, 0.965))
    stamp = np.datetime_as_string(grid["time"].to_numpy(), unit="m").replace("T", " ")
    figure.suptitle(f"Fire weather indices, {stamp} UTC", fontsize=14)
    panels = figure.subplots(2, 3).ravel()
    for axes, (name, classes) in zip(panels, CLASSES.items(), strict=False):
        _panel(axes, grid, name, classes)
    for axes in panels[len(CLASSES) :]:
        axes.set_axis_off()
    figures.save(figure, path, attributes)


def _panel(axes: Any, grid: xr.Dataset, name: str, classes: Classes) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    count = len(classes.words)
    colours = COLOURS if count == len(COLOURS) else tuple(COLOURS[i] for i in (0, 1, 3, 4))
    inside = classify(grid[name].to_numpy(), classes)
    axes.set_facecolor("0.75")
    axes.pcolormesh(
        grid["longitude"],
        grid["latitude"],
        np.ma.masked_invalid(inside),
        cmap=ListedColormap(colours),
        vmin=-0.5,
        vmax=count - 0.5,
        shading="nearest",
    )
    elevation = grid["elevation_m"].to_numpy()
    if np.nanmin(elevation) < COAST_M < np.nanmax(elevation):  # the coast, to find one's way by
        axes.contour(grid["longitude"], grid["latitude"], elevation, [COAST_M], colors="0.25", linewidths=0.7)
    axes.set_aspect(1 / float(np.cos(np.radians(grid["latitude"].mean()))))
    axes.set_title(f"{classes.title} (classes: {classes.origin})", fontsize=9)
    axes.tick_params(labelsize=7)
    patches = [
        Patch(color=c, label=f"{w} {r}") for c, w, r in zip(colours, classes.words, _ranges(classes), strict=True)
    ]
    axes.legend(handles=[*patches, Patch(color="0.75", label="no value")], fontsize=7, loc="lower left")


def _ranges(classes: Classes) -> list[str]:
    marks = [f"{value:g}" for value in classes.breaks]
    first, last = ("≥", "<") if classes.falling else ("<", "≥")
    middle = [f"{low}-{high}" for low, high in pairwise(marks)]
    return [f"{first} {marks[0]}", *middle, f"{last} {marks[-1]}"]
