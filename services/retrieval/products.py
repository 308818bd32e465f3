"""What leaves the retrieval: contract tables, the level-3 soil-moisture grid, maps for people, reports."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from services.retrieval.burned_area import BurnedModel, confidence
from services.retrieval.constants import FILL
from services.retrieval.ease_grid import centre, centre_metres, ease_grid
from services.retrieval.features import Observations

RAW_IF_VOLUME_RATIO = 1680  # bytes of a raw-IF second over those of a nominal second (CYGNSS)
EASE_CRS = {
    "grid_mapping_name": "lambert_cylindrical_equal_area",
    "standard_parallel": 30.0,
    "longitude_of_central_meridian": 0.0,
    "false_easting": 0.0,
    "false_northing": 0.0,
    "semi_major_axis": 6378137.0,
    "inverse_flattening": 298.257223563,
    "epsg_code": "EPSG:6933",
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


def observation_report(observations: Observations) -> dict[str, Any]:
    """Maps read, used and screened out by reason, by mode; and the data volumes behind them."""
    looks = observations.looks
    used = {str(mode): int(count) for mode, count in looks["mode"].value_counts().sort_index().items()}
    seconds = looks.drop_duplicates(["mode", "satellite", "time"])["mode"].value_counts()
    return {
        "screening": observations.screening,
        "looks_used": used,
        "nominal_seconds": int(seconds.get("nominal", 0)),
        "raw_if_seconds": int(seconds.get("raw-if", 0)),
        "raw_if_volume_in_nominal_seconds": int(seconds.get("raw-if", 0)) * RAW_IF_VOLUME_RATIO,
    }


def level3_grid(table: pd.DataFrame) -> xr.Dataset:
    """Daily soil moisture on EASE-Grid 2.0 (9 km): ``SM_daily``, ``SIGMA_daily``, ``count`` (time, y, x).

    The grid covers the box of the table's cells (one empty cell without any). Modes of a day and cell are joined with
    inverse-variance weights. Named as in the UCAR/CU level-3 product.
    """
    rows = _span(table["row"])
    columns = _span(table["column"])
    days = pd.to_datetime(table["time"], utc=True).dt.tz_localize(None).to_numpy().astype("datetime64[D]")
    known_days = np.unique(days) if len(days) else np.array(["1970-01-01"], dtype="datetime64[D]")
    shape = (known_days.size, rows.size, columns.size)
    weight, total, count = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.int32)
    if len(table):
        cell = table["row"].to_numpy() - rows[0], table["column"].to_numpy() - columns[0]
        place = (np.searchsorted(known_days, days), *cell)
        share = 1.0 / np.maximum(table["soil_moisture_sd"].to_numpy(), 1e-3) ** 2
        np.add.at(weight, place, share)
        np.add.at(total, place, share * table["soil_moisture"].to_numpy())
        np.add.at(count, place, table["count"].to_numpy())
    seen = weight > 0
    safe = np.where(seen, weight, 1.0)
    values = {
        "SM_daily": (np.where(seen, total / safe, FILL), "volumetric soil moisture, m3 m-3"),
        "SIGMA_daily": (np.where(seen, 1.0 / np.sqrt(safe), FILL), "standard deviation of SM_daily, m3 m-3"),
    }
    return _level3_dataset(values, count, known_days, rows, columns)


def _span(index: pd.Series) -> NDArray[np.int64]:
    return np.arange(index.min(), index.max() + 1) if len(index) else np.array([0])


def _level3_dataset(values, count, days, rows, columns) -> xr.Dataset:
    x, _ = centre_metres(np.zeros_like(columns), columns, 9)
    _, y = centre_metres(rows, np.zeros_like(rows), 9)
    latitude, longitude = centre(*np.meshgrid(rows, columns, indexing="ij"), 9)
    dims, flat = ("time", "y", "x"), ("y", "x")
    common = {"units": "1", "grid_mapping": "crs"}
    fill = {"_FillValue": np.float32(FILL)}
    dataset = xr.Dataset(
        {
            name: (dims, data.astype(np.float32), {**common, **fill, "long_name": text})
            for name, (data, text) in values.items()
        },
        coords={
            "time": ("time", days.astype("datetime64[ns]"), {"standard_name": "time", "long_name": "UTC day"}),
            "y": ("y", y, {"standard_name": "projection_y_coordinate", "units": "m"}),
            "x": ("x", x, {"standard_name": "projection_x_coordinate", "units": "m"}),
            "latitude": (flat, latitude, {"standard_name": "latitude", "units": "degrees_north"}),
            "longitude": (flat, longitude, {"standard_name": "longitude", "units": "degrees_east"}),
        },
        attrs={
            "title": "Soil moisture from GNSS reflectivity, daily, EASE-Grid 2.0 9 km",
            "grid": ease_grid(9).name,
            "first_row": int(rows[0]),
            "first_column": int(columns[0]),
            "references": "Chew and Small 2020, doi:10.3390/rs12101558",
        },
    )
    dataset["SM_daily"].attrs |= {
        "standard_name": "volume_fraction_of_condensed_water_in_soil",
        "ancillary_variables": "SIGMA_daily count",
    }
    dataset["count"] = (dims, count, {**common, "long_name": "looks in the cell and day"})
    dataset["crs"] = ((), np.int32(6933), EASE_CRS)
    return dataset


def footer(attributes: Mapping[str, Any]) -> str:
    """The line that every map carries: simulated or not, oldest input, code."""
    share = f" ({100 * float(attributes.get('simulated_share', 0)):.0f} %)"
    state = f"SIMULATED input{share}" if attributes.get("simulated") else "no simulated input"
    oldest = attributes.get("oldest_input") or "unknown"
    return f"{state} · oldest input {oldest} · code {attributes.get('code_version', '')}"


def burned_area_map(table: geopandas.GeoDataFrame, path: Path, attributes: Mapping[str, Any], threshold: float) -> None:
    """Looks coloured by burned probability, verdicts ringed; circles nominal, squares raw-IF (PNG)."""
    from matplotlib.figure import Figure  # no pyplot: no global state, no display

    figure = Figure(figsize=(9.0, 7.6), dpi=110)
    axes = figure.add_axes((0.09, 0.12, 0.78, 0.78))
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
    figure.text(0.01, 0.01, footer(attributes), fontsize=7, color="0.35")
    figure.savefig(path, metadata={"Software": None})


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
