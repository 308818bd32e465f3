"""What leaves the burned-area retrieval: the contract's points, a map on EASE-Grid 2.0, GeoJSON and a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from services.retrieval.burned_area.model import BurnedModel, confidence
from services.retrieval.constants import FILL
from services.retrieval.ease_grid import EASE_CRS, cell_coordinates, corner_transform, ease_grid, row_column
from services.retrieval.looks.observation_report import screening_note
from shared import figures
from shared.contracts.cog import write_cog

MAP_KM = 3  # a look blurs over 1 to 7 km
NOT_SEEN, UNBURNED, BURNED = 0, 1, 2
MAX_GEOJSON_POINTS = 5_000  # the rest is in the table; browsers give up beyond
LAYERS = {
    "burned_probability": ("probability that the cell has burned by its last look", "1"),
    "burned_class": ("0 not seen, 1 unburned, 2 burned", "1"),
    "count": ("looks in the cell", "1"),
    "burned_count": ("looks in the cell that were judged burned", "1"),
}


def burned_area_table(looks: pd.DataFrame, probability: NDArray, model: BurnedModel) -> geopandas.GeoDataFrame:
    """The burned_area contract, a row a look, sorted by time; with ``satellite``, ``prn`` and ``reflectivity_db``.

    ``prior_probability`` is the burned share that the probability was calibrated on: whoever knows better what share
    has burned at a place (beside an active fire, say) takes the odds ratio of the two as the look's evidence.
    """
    frame = pd.DataFrame(
        {
            "time": looks["time"],
            "along_m": looks["along_m"],
            "across_m": looks["across_m"],
            "burned_probability": probability,
            "prior_probability": model.base_rate,
            "burned": probability >= model.threshold,
            "confidence": confidence(probability, model.threshold),
            "mode": looks["mode"],
            "satellite": [f"CYGFM{int(n):02d}" for n in looks["satellite"]],
            "prn": looks["prn"].astype(np.int64),
            "reflectivity_db": looks["reflectivity_db"],
        }
    )
    points = geopandas.points_from_xy(looks["longitude_deg"], looks["latitude_deg"])
    table = geopandas.GeoDataFrame(frame, geometry=points, crs="EPSG:4326")
    return table.sort_values(["time", "satellite", "prn", "mode"], kind="stable", ignore_index=True)


def burned_area_grid(table: geopandas.GeoDataFrame, threshold: float) -> xr.Dataset:
    """Looks on EASE-Grid 2.0 (3 km) cells, LAYERS on (y, x) over the box of the looks (one empty cell without any).

    A cell's probability joins the evidence of its looks: the mean of their log odds. The mean, not the sum, for looks
    of one place share its errors.
    """
    row, column = row_column(table.geometry.y.to_numpy(), table.geometry.x.to_numpy(), MAP_KM)
    rows = np.arange(row.min(), row.max() + 1) if len(row) else np.array([0])
    columns = np.arange(column.min(), column.max() + 1) if len(row) else np.array([0])
    shape = (rows.size, columns.size)
    cell = (row - rows[0]) * columns.size + column - columns[0]
    share = np.clip(table["burned_probability"].to_numpy(dtype=np.float64), 1e-6, 1.0 - 1e-6)
    count = np.bincount(cell, minlength=rows.size * columns.size)
    odds = np.bincount(cell, np.log(share / (1.0 - share)), count.size) / np.maximum(count, 1)
    probability = 1.0 / (1.0 + np.exp(-odds))
    seen = count > 0
    burned = np.bincount(cell, table["burned"].to_numpy(dtype=np.float64), count.size)
    values = {
        "burned_probability": np.where(seen, probability, FILL).astype(np.float32),
        "burned_class": np.where(seen, np.where(probability >= threshold, BURNED, UNBURNED), NOT_SEEN).astype(np.uint8),
        "count": count.astype(np.int32),
        "burned_count": burned.astype(np.int32),
    }
    return _dataset({name: value.reshape(shape) for name, value in values.items()}, rows, columns)


def _dataset(values: Mapping[str, NDArray], rows: NDArray, columns: NDArray) -> xr.Dataset:
    flat = ("y", "x")
    dataset = xr.Dataset(
        {
            name: (flat, data, {"long_name": LAYERS[name][0], "units": LAYERS[name][1], "grid_mapping": "crs"})
            for name, data in values.items()
        },
        coords=cell_coordinates(rows, columns, MAP_KM),
        attrs={
            "title": f"Burned area from GNSS reflections, EASE-Grid 2.0 {MAP_KM} km",
            "grid": ease_grid(MAP_KM).name,
            "first_row": int(rows[0]),
            "first_column": int(columns[0]),
        },
    )
    dataset["burned_probability"].attrs["_FillValue"] = np.float32(FILL)
    dataset["burned_probability"].attrs["ancillary_variables"] = "count burned_count"
    dataset["burned_class"].attrs |= {
        "flag_values": np.array([NOT_SEEN, UNBURNED, BURNED], dtype=np.uint8),
        "flag_meanings": "not_seen unburned burned",
    }
    dataset["crs"] = ((), np.int32(6933), EASE_CRS)
    return dataset


def write_burned_cog(path: Path, grid: xr.Dataset, attributes: Mapping[str, Any]) -> None:
    """The grid's LAYERS as bands of a Cloud-Optimised GeoTIFF (float32, EPSG:6933), the first row northernmost."""
    transform = corner_transform(grid, MAP_KM)
    bands = {name: grid[name].to_numpy().astype(np.float32) for name in LAYERS}
    write_cog(path, bands, transform=transform, crs="EPSG:6933", nodata=FILL, attributes=attributes)


def write_burned_geojson(path: Path, table: geopandas.GeoDataFrame, attributes: Mapping[str, Any]) -> int:
    """Looks as GeoJSON points (RFC 7946), the likeliest burned first where there are more than MAX_GEOJSON_POINTS.

    Returns the number of looks left out; the file says it, too.
    """
    ordered = table.sort_values("burned_probability", ascending=False, kind="stable").head(MAX_GEOJSON_POINTS)
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [round(point.x, 5), round(point.y, 5)]},
            "properties": {
                "time": time.strftime("%Y-%m-%dT%H:%M:%SZ"),
                "burned": bool(burned),
                "burned_probability": round(float(probability), 4),
                "confidence": round(float(sure), 1),
                "mode": mode,
                "satellite": satellite,
            },
        }
        for point, time, burned, probability, sure, mode, satellite in zip(
            ordered.geometry, ordered["time"], ordered["burned"], ordered["burned_probability"],
            ordered["confidence"], ordered["mode"], ordered["satellite"], strict=True,
        )
    ]  # fmt: skip
    left_out = len(table) - len(ordered)
    document = {"type": "FeatureCollection", "product": dict(attributes), "left_out": left_out, "features": features}
    path.write_text(json.dumps(document, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")
    return left_out


def burned_area_map(
    table: geopandas.GeoDataFrame,
    path: Path,
    attributes: Mapping[str, Any],
    threshold: float,
    perimeters: geopandas.GeoDataFrame | None = None,
) -> None:
    """Looks coloured by burned probability over fire perimeters (PNG): verdicts ringed, circles nominal, squares
    raw-IF.
    """
    from matplotlib.figure import Figure  # no pyplot: no global state, no display

    figure = Figure(figsize=(9.0, 7.6))
    axes = figure.add_axes((0.09, 0.12, 0.78, 0.78))
    if perimeters is not None:
        _draw_perimeters(axes, perimeters)
    drawn = _draw_looks(axes, table.sort_values("burned_probability", kind="stable"), threshold)
    bar = figure.add_axes((0.89, 0.12, 0.025, 0.78))
    figure.colorbar(drawn, cax=bar, label="probability that the place has burned")
    axes.set_xlabel("longitude (degrees east)")
    axes.set_ylabel("latitude (degrees north)")
    span = "no usable look"
    if len(table):
        shrink = max(np.cos(np.deg2rad(float(table.geometry.y.mean()))), 0.1)
        axes.set_aspect(1.0 / shrink, adjustable="datalim")
        span = f"{table['time'].min():%Y-%m-%d %H:%M} to {table['time'].max():%Y-%m-%d %H:%M} UTC"
    verdicts = f"{int(table['burned'].sum())} of {len(table)} looks burned (ringed: {threshold:.2f} and more)"
    axes.set_title(f"Burned area from GNSS reflections\n{span}; {verdicts}", fontsize=10)
    axes.legend(loc="upper right", fontsize=8)
    axes.grid(alpha=0.3)
    figure.text(0.008, 0.026, screening_note(attributes), fontsize=5.5, color="0.35", va="bottom")
    figures.save(figure, path, attributes)


def _draw_perimeters(axes: Any, perimeters: geopandas.GeoDataFrame) -> None:
    outlines = perimeters.geometry[~(perimeters.geometry.is_empty | perimeters.geometry.isna())]
    for number, line in enumerate(part for shape in outlines.boundary for part in getattr(shape, "geoms", [shape])):
        x, y = line.xy
        axes.plot(x, y, color="#1f5fa8", linewidth=0.9, label="mapped perimeters" if number == 0 else None, zorder=1)


def _draw_looks(axes: Any, ordered: geopandas.GeoDataFrame, threshold: float) -> Any:
    top = max(float(ordered["burned_probability"].max()) if len(ordered) else 0.0, min(2 * threshold, 1.0))
    drawn = None
    for mode, marker, size in (("nominal", "o", 14), ("raw-if", "s", 26)):
        part = ordered[ordered["mode"] == mode]
        drawn = axes.scatter(
            part.geometry.x,
            part.geometry.y,
            c=part["burned_probability"],
            s=size,
            marker=marker,
            edgecolors=np.where(part["burned"], "black", "0.75"),
            linewidths=0.7,
            cmap="YlOrRd",
            vmin=0.0,
            vmax=top,
            label=f"{mode} ({len(part)})",
        )
    return drawn
