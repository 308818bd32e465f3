"""Scores of fire arrival and burned area against the nature run's truth or against mapped perimeters."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
import xarray as xr
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from shared.errors import DomainError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class ArrivalField:
    """Fire arrival on a projected grid: ``arrival_s`` (y, x) seconds since ``reference_time``, NaN unburned; metres."""

    arrival_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    crs: CRS
    reference_time: datetime

    @property
    def cell_km2(self) -> float:
        return float(abs((self.x_m[1] - self.x_m[0]) * (self.y_m[1] - self.y_m[0])) / 1e6)

    def seconds(self, time: datetime) -> float:
        """A UTC time on the field's own clock, s."""
        return (pd.Timestamp(time) - pd.Timestamp(self.reference_time)).total_seconds()

    def burned_by(self, time: datetime) -> BoolArray:
        """Cells (y, x) that the fire had reached by a UTC time."""
        return np.nan_to_num(self.arrival_s, nan=np.inf) <= self.seconds(time)


def read_arrival(path: str | Path, variable: str = "fire_arrival_time") -> ArrivalField:
    """A ``fire_arrival`` product, or one fire of a truth file (``variable`` ``fire_arrival_time_<incident_id>``).

    Cells whose ``burned_probability`` (where the file has it) is below one half count as unburned.
    """
    with xr.open_dataset(path, decode_times=False) as opened:
        if variable not in opened:
            raise DomainError(
                f"'{Path(path).name}' has no variable '{variable}'.",
                field=variable,
                accepted=", ".join(str(name) for name in opened.data_vars),
            )
        field = opened[variable].load()
        crs = CRS.from_wkt(opened["crs"].attrs["crs_wkt"])
        reference = field.attrs.get("reference_time") or opened.attrs["reference_time"]
        values = field.values.astype(np.float64)
        if variable == "fire_arrival_time" and "burned_probability" in opened:
            values = np.where(opened["burned_probability"].values >= 0.5, values, np.nan)
    along, across = field.dims
    time = pd.Timestamp(reference)
    time = time.tz_localize("UTC") if time.tzinfo is None else time.tz_convert("UTC")
    return ArrivalField(values, field[across].values, field[along].values, crs, time.to_pydatetime())


def truth_incidents(path: str | Path) -> list[str]:
    """The incident ids that a truth file holds."""
    with xr.open_dataset(path, decode_times=False) as opened:
        return [str(name)[18:] for name in opened.data_vars if str(name).startswith("fire_arrival_time_")]


def resampled(field: ArrivalField, like: ArrivalField) -> ArrivalField:
    """The field at the cell centres of another's grid (nearest cell, unburned outside), on the other's clock."""
    x, y = np.meshgrid(like.x_m, like.y_m)
    if like.crs != field.crs:
        x, y = Transformer.from_crs(like.crs, field.crs, always_xy=True).transform(x, y)
    values = _nearest(field, x, y) + like.seconds(field.reference_time)
    return ArrivalField(values, like.x_m, like.y_m, like.crs, like.reference_time)


def _nearest(field: ArrivalField, x: FloatArray, y: FloatArray) -> FloatArray:
    columns = np.rint((x - field.x_m[0]) / (field.x_m[1] - field.x_m[0])).astype(int)
    rows = np.rint((y - field.y_m[0]) / (field.y_m[1] - field.y_m[0])).astype(int)
    inside = (rows >= 0) & (rows < len(field.y_m)) & (columns >= 0) & (columns < len(field.x_m))
    values = np.full(np.shape(x), np.nan)
    values[inside] = field.arrival_s[rows[inside], columns[inside]]
    return values


def arrival_scores(product: ArrivalField, truth: ArrivalField, at: datetime) -> dict[str, float]:
    """Errors of arrival where both burned by ``at`` (h; bias positive: too late) and of extent at ``at``.

    ``mae_h``, ``bias_h``, ``rmse_h``, ``f1_extent`` (the same number as ``sorensen``), ``precision``, ``recall``,
    ``truth_km2``, ``product_km2``; errors are NaN where nothing is shared. The truth's grid decides, and the part of
    the product outside the truth's window is not scored.
    """
    ours = resampled(product, truth)
    ours_burned, true_burned = ours.burned_by(at), truth.burned_by(at)
    both = ours_burned & true_burned
    error_h = (ours.arrival_s[both] - truth.arrival_s[both]) / 3600.0
    overlap = extent_scores(ours_burned, true_burned)
    return {
        "mae_h": _mean(np.abs(error_h)),
        "bias_h": _mean(error_h),
        "rmse_h": float(np.sqrt(_mean(error_h**2))),
        "f1_extent": overlap["sorensen"],
        **overlap,
        "truth_km2": float(true_burned.sum() * truth.cell_km2),
        "product_km2": float(ours_burned.sum() * truth.cell_km2),
    }


def extent_scores(ours: BoolArray, true: BoolArray) -> dict[str, float]:
    """Sørensen coefficient 2|A∩B|/(|A|+|B|), precision and recall of two masks; NaN where undefined."""
    shared = float((ours & true).sum())
    return {
        "sorensen": _ratio(2.0 * shared, float(ours.sum() + true.sum())),
        "precision": _ratio(shared, float(ours.sum())),
        "recall": _ratio(shared, float(true.sum())),
    }


def perimeter_scores(
    product: ArrivalField, perimeter: Any, polygon_time: datetime, known_at: datetime
) -> dict[str, float]:
    """Scores of a product against one mapped perimeter (geometry in EPSG:4326).

    The fire had this outline at an unknown time in [``polygon_time``, ``known_at``]. ``sorensen`` is the mean over
    that span, hour by hour; the values at its ends stand beside it. The bracket: cells just inside the outline must
    have burned by ``known_at``, cells just outside must not have burned before ``polygon_time``.
    ``bracket_fraction`` is the share of both that obey, ``bracket_error_h`` how far those with an arrival fall
    outside on average (0 for the others), ``outline_missed`` the share of inner cells without any arrival.
    """
    mask = rasterised(product, perimeter)
    hours = max(int((known_at - polygon_time) / timedelta(hours=1)), 1)
    moments = [polygon_time + (known_at - polygon_time) * (i / hours) for i in range(hours + 1)]
    values = [extent_scores(product.burned_by(moment), mask)["sorensen"] for moment in moments]
    return {
        "sorensen": _mean(np.array(values)),
        "sorensen_at_polygon_time": values[0],
        "sorensen_at_known_at": values[-1],
        "perimeter_km2": float(mask.sum() * product.cell_km2),
        "product_km2": float(product.burned_by(known_at).sum() * product.cell_km2),
        **_bracket(product, mask, polygon_time, known_at),
    }


def _bracket(product: ArrivalField, mask: BoolArray, earliest: datetime, latest: datetime) -> dict[str, float]:
    inner, outer = mask & _touches(~mask), ~mask & _touches(mask)
    arrival = product.arrival_s
    late_h = (arrival[inner] - product.seconds(latest)) / 3600.0
    early_h = (product.seconds(earliest) - arrival[outer]) / 3600.0
    inner_good, outer_good = late_h <= 0, ~(early_h > 0)
    violations = np.concatenate([np.clip(late_h[np.isfinite(late_h)], 0, None), np.clip(early_h, 0, None)])
    return {
        "bracket_fraction": _mean(np.concatenate([inner_good, outer_good]).astype(float)),
        "bracket_error_h": _mean(np.nan_to_num(violations)),
        "outline_missed": _mean(np.isnan(late_h).astype(float)),
    }


def _touches(mask: BoolArray) -> BoolArray:
    """Cells with a set cell above, below, left or right of them."""
    around = np.pad(mask, 1)
    return around[:-2, 1:-1] | around[2:, 1:-1] | around[1:-1, :-2] | around[1:-1, 2:]


def rasterised(field: ArrivalField, geometry: Any) -> BoolArray:
    """Cells (y, x) whose centre lies in a geometry given in EPSG:4326; any kind of (collected) polygon."""
    polygons = polygonal(geometry)
    x, y = np.meshgrid(field.x_m, field.y_m)
    longitude, latitude = Transformer.from_crs(field.crs, 4326, always_xy=True).transform(x, y)
    shapely.prepare(polygons)
    inside: BoolArray = shapely.contains_xy(polygons, longitude, latitude)
    return inside


def polygonal(geometry: Any) -> Any:
    """The polygons of a geometry, made valid and united: lines and points of a collection fall away."""
    parts = [p for p in shapely.get_parts(shapely.make_valid(geometry)) if p.geom_type != "LineString"]
    flat = [q for p in parts for q in shapely.get_parts(p) if q.geom_type in ("Polygon", "MultiPolygon")]
    return shapely.union_all(flat)


def burned_area_scores(points: pd.DataFrame, truths: list[ArrivalField]) -> dict[str, float]:
    """Scores of burned-area points (contract ``burned_area``) against the truth at each point's time.

    True label: at least half of the ground within half the footprint's mean width was burned by then. Gives
    ``points``, ``base_rate``, ``accuracy``, ``f1``, ``brier`` and ``auc`` (NaN where one class is missing).
    """
    if not len(points):
        return {"points": 0.0, **dict.fromkeys(("base_rate", "accuracy", "f1", "brier", "auc"), float("nan"))}
    true = burned_fraction(points, truths) >= 0.5
    probability = points["burned_probability"].to_numpy(dtype=np.float64)
    said = points["burned"].to_numpy(dtype=bool)
    return {
        "points": float(len(points)),
        "base_rate": float(true.mean()),
        "accuracy": float((said == true).mean()),
        "f1": extent_scores(said, true)["sorensen"],
        "brier": float(((probability - true) ** 2).mean()),
        "auc": rank_auc(probability, true),
    }


def burned_fraction(points: pd.DataFrame, truths: list[ArrivalField]) -> FloatArray:
    """Share of each point's footprint (a disc of its mean width) that had burned by the point's time."""
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    width = 0.25 * (points["along_m"].to_numpy() + points["across_m"].to_numpy())
    rings = np.concatenate([[0.0], np.full(12, 0.5), np.full(12, 0.9)])
    turn = np.concatenate([[0.0], angles, angles + np.pi / 12])
    times = pd.to_datetime(points["time"], utc=True)
    burned = np.zeros((len(points), len(rings)), dtype=bool)
    longitude, latitude = points.geometry.x.to_numpy(), points.geometry.y.to_numpy()
    for truth in truths:
        x, y = Transformer.from_crs(4326, truth.crs, always_xy=True).transform(longitude, latitude)
        arrival = _nearest(
            truth,
            x[:, None] + width[:, None] * rings * np.sin(turn),
            y[:, None] + width[:, None] * rings * np.cos(turn),
        )
        clock = (times - pd.Timestamp(truth.reference_time)).dt.total_seconds().to_numpy()
        burned |= np.nan_to_num(arrival, nan=np.inf) <= clock[:, None]
    return burned.mean(axis=1)


def rank_auc(score: FloatArray, label: BoolArray) -> float:
    """Area under the ROC curve from ranks (ties shared); NaN where one class is missing."""
    positive = int(label.sum())
    negative = len(label) - positive
    if not positive or not negative:
        return float("nan")
    ranks = pd.Series(score).rank().to_numpy()
    return float((ranks[label].sum() - positive * (positive + 1) / 2) / (positive * negative))


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if len(values) else float("nan")
