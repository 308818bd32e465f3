"""The place's own pre-fire reflectivity, and how far a look departs from it."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.retrieval.ease_grid import row_column, to_metres
from shared.errors import DomainError

REFERENCE_INCIDENCE_DEG = 30.0
NEIGHBOUR_WEIGHT = 2.0  # looks: weight of the 9 km mean in a 3 km cell's mean
NEAR_M, NEAR_H, NEAR_LOOKS = 8_000.0, 36.0, 16  # nearness in space and time of looks that vouch for each other
COLUMNS = ("row", "column", "reflectivity_mean_db", "reflectivity_sd_db", "count")
CHANGE_FEATURES = (
    "change_db",
    "change_z",
    "change_local_db",
    "change_near_db",
    "change_near_weight",
    "coherence_change",
    "baseline_sd_db",
    "baseline_looks",
)


def build_baseline(looks: pd.DataFrame) -> pd.DataFrame:
    """Pre-fire statistics per EASE cell of 3 and 9 km from looks (columns of ``read_observations``).

    Columns: ``resolution_km``, ``row``, ``column``, ``reflectivity_mean_db`` (at 30 deg incidence),
    ``reflectivity_sd_db``, ``count``, ``coherence_mean``, ``incidence_slope_db_per_deg``. A 3 km mean leans on its 9
    km cell with the weight of two looks, since few looks fall in it.
    """
    slope = incidence_slope(looks)
    flat = looks["reflectivity_db"] - slope * (looks["incidence_deg"] - REFERENCE_INCIDENCE_DEG)
    row3, column3 = row_column(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy(), 3)
    frame = pd.DataFrame(
        {"row": looks["row"], "column": looks["column"], "row3": row3, "column3": column3, "flat": flat}
    ).assign(coherence=np.log(np.maximum(looks["coherence"], 1e-3)))
    coarse = _statistics(frame, ["row", "column"], prior=None)
    near = frame.merge(coarse, on=["row", "column"], how="left")
    fine = _statistics(near, ["row3", "column3"], prior="reflectivity_mean_db")
    fine = fine.rename(columns={"row3": "row", "column3": "column"})
    table = pd.concat([fine.assign(resolution_km=3), coarse.assign(resolution_km=9)], ignore_index=True)
    table["incidence_slope_db_per_deg"] = slope
    return table.astype({"row": np.int32, "column": np.int32, "count": np.int32, "resolution_km": np.int32})


def _statistics(frame: pd.DataFrame, keys: list[str], prior: str | None) -> pd.DataFrame:
    groups = frame.groupby(keys, sort=True)
    count = groups["flat"].size()
    mean, spread = groups["flat"].mean(), groups["flat"].std(ddof=1)
    pooled = float(np.sqrt(np.average(np.nan_to_num(spread**2), weights=np.maximum(count - 1, 1e-9))))
    variance = (np.nan_to_num(spread**2) * np.maximum(count - 1, 0) + 3.0 * pooled**2) / (count + 2.0)
    if prior is not None:
        around = groups[prior].mean()
        mean = (count * mean + NEIGHBOUR_WEIGHT * around) / (count + NEIGHBOUR_WEIGHT)
    return pd.DataFrame(
        {
            "reflectivity_mean_db": mean,
            "reflectivity_sd_db": np.sqrt(variance),
            "count": count,
            "coherence_mean": groups["coherence"].mean(),
        }
    ).reset_index()


def incidence_slope(looks: pd.DataFrame) -> float:
    """Change of reflectivity with incidence (dB/deg) within 9 km cells, by least squares; 0 with too few looks."""
    if len(looks) < 50:
        return 0.0
    groups = looks.groupby(["row", "column"])
    angle = looks["incidence_deg"] - groups["incidence_deg"].transform("mean")
    value = looks["reflectivity_db"] - groups["reflectivity_db"].transform("mean")
    return float((angle * value).sum() / max(float((angle**2).sum()), 1e-9))


def check_baseline(table: pd.DataFrame) -> pd.DataFrame:
    """The table with its optional columns filled in; DomainError names a missing one."""
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise DomainError(
            f"The burned-area baseline lacks {', '.join(missing)}.",
            field=f"baseline.{missing[0]}",
            accepted=", ".join(COLUMNS),
        )
    full = table.copy()
    for name, value in (("resolution_km", 9), ("coherence_mean", np.nan), ("incidence_slope_db_per_deg", 0.0)):
        if name not in full.columns:
            full[name] = value
    return full


def change_features(looks: pd.DataFrame, baseline: pd.DataFrame | None) -> pd.DataFrame:
    """CHANGE_FEATURES of looks, aligned to them; all NaN where the place has no baseline.

    ``change_db`` against the finest cell known (3, else 9 km), ``change_z`` in its sd, ``change_local_db`` less the
    median change of that day, mode and 108 km block (which rain moves as a whole), ``change_near_db`` the mean of
    that over neighbouring looks, weighted by nearness (8 km and 1.5 days), ``change_near_weight`` their weight.
    """
    if baseline is None or not len(looks):
        return pd.DataFrame(np.nan, index=looks.index, columns=list(CHANGE_FEATURES))
    place = _lookup(looks, check_baseline(baseline))
    slope = place["incidence_slope_db_per_deg"].fillna(0.0)
    expected = place["reflectivity_mean_db"] + slope * (looks["incidence_deg"] - REFERENCE_INCIDENCE_DEG)
    change = looks["reflectivity_db"] - expected
    day = looks["time"].to_numpy().astype("datetime64[D]").astype(np.int64)
    block = [day, looks["mode"].astype(str), looks["row"] // 12, looks["column"] // 12]
    local = change - change.groupby(block).transform("median")
    near, weight = _near_mean(looks, local.to_numpy())
    return pd.DataFrame(
        {
            "change_db": change,
            "change_z": change / np.maximum(place["reflectivity_sd_db"], 0.5),
            "change_local_db": local,
            "change_near_db": near,
            "change_near_weight": weight,
            "coherence_change": np.log(np.maximum(looks["coherence"], 1e-3)) - place["coherence_mean"],
            "baseline_sd_db": place["reflectivity_sd_db"],
            "baseline_looks": place["count"],
        },
        index=looks.index,
    )


def _near_mean(looks: pd.DataFrame, value: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean of ``value`` over the nearest looks (itself among them) with Gaussian weights, and the sum of weights,
    (n,).
    """
    mean, total = np.full(value.size, np.nan), np.full(value.size, np.nan)
    known = np.isfinite(value)
    if not known.any():
        return mean, total
    x, y = to_metres(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy())
    hours = looks["time"].to_numpy().astype("datetime64[ms]").astype(np.int64) / 3.6e6
    position = np.stack([x / NEAR_M, y / NEAR_M, hours / NEAR_H], axis=1)[known]
    near = min(NEAR_LOOKS, int(known.sum()))
    distance, index = cKDTree(position).query(position, k=near)
    distance, index = distance.reshape(-1, near), index.reshape(-1, near)
    weight = np.exp(-0.5 * distance**2)
    total[known] = weight.sum(axis=1)
    mean[known] = (weight * value[known][index]).sum(axis=1) / total[known]
    return mean, total


def _lookup(looks: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """Baseline rows of looks: the finest resolution that holds the look's cell."""
    columns = ["reflectivity_mean_db", "reflectivity_sd_db", "count", "coherence_mean", "incidence_slope_db_per_deg"]
    found = np.full((len(looks), len(columns)), np.nan)
    for resolution in sorted(table["resolution_km"].unique(), reverse=True):
        part = table[table["resolution_km"] == resolution]
        row, column = row_column(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy(), int(resolution))
        values = part[columns].to_numpy(dtype=np.float64)
        index = _match(_key(row, column), _key(part["row"].to_numpy(), part["column"].to_numpy()))
        found[index >= 0] = values[index[index >= 0]]
    return pd.DataFrame(found, columns=columns, index=looks.index)


def _key(row: NDArray, column: NDArray) -> NDArray[np.int64]:
    return np.asarray(row, dtype=np.int64) * 100_000 + np.asarray(column, dtype=np.int64)


def _match(wanted: NDArray[np.int64], keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Index into ``keys`` of each wanted key, -1 where it is not there."""
    if not keys.size:
        return np.full(wanted.size, -1)
    order = np.argsort(keys, kind="stable")
    place = np.minimum(np.searchsorted(keys[order], wanted), keys.size - 1)
    return np.where(keys[order][place] == wanted, order[place], -1)
