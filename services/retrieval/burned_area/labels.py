"""Burned or unburned labels of looks from a table of dated places or from a burn-time grid."""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.retrieval.ancillary.burn_grid import burn_times
from shared.errors import DomainError

EARTH_RADIUS_M = 6_371_000.0
NEIGHBOURS = 8
UNKNOWN, UNBURNED, BURNED = -1, 0, 1


def label_looks(looks: pd.DataFrame, labels: pd.DataFrame, radius_m: float = 1500.0) -> NDArray[np.int8]:
    """BURNED where at least half of the label places within ``radius_m`` had burned by the look's time, (n,).

    ``labels`` has ``longitude_deg``, ``latitude_deg``, ``burn_time`` (NaT: never burned). UNKNOWN where no place is
    near.
    """
    missing = [name for name in ("longitude_deg", "latitude_deg", "burn_time") if name not in labels.columns]
    if missing:
        raise DomainError(
            f"The labels lack {', '.join(missing)}.",
            field=f"labels.{missing[0]}",
            accepted="longitude_deg, latitude_deg, burn_time",
        )
    places = _unit_vectors(labels["latitude_deg"].to_numpy(), labels["longitude_deg"].to_numpy())
    finite = np.isfinite(places).all(axis=1)
    if not finite.all():
        raise DomainError(
            f"Label row {int(np.flatnonzero(~finite)[0])} has no finite position.", field="labels", accepted="degrees"
        )
    times = pd.to_datetime(labels["burn_time"], utc=True).dt.tz_localize(None).to_numpy().astype("datetime64[ms]")
    where = _unit_vectors(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy())
    near = min(NEIGHBOURS, len(labels))
    distance, index = cKDTree(places).query(where, k=near, distance_upper_bound=radius_m / EARTH_RADIUS_M)
    found = np.isfinite(distance).reshape(len(looks), near)
    index = np.where(found, index.reshape(len(looks), near), 0)
    burned = (times[index] <= looks["time"].to_numpy().astype("datetime64[ms]")[:, None]) & found
    count = found.sum(axis=1)
    label = np.where(2 * burned.sum(axis=1) >= count, BURNED, UNBURNED)
    return np.where(count > 0, label, UNKNOWN).astype(np.int8)


def labels_from_grid(path: str) -> pd.DataFrame:
    """A labels table from a netCDF with ``burn_time`` on a latitude and a longitude axis (see ``burn_grid``)."""
    try:
        with xr.open_dataset(path) as opened:
            times, rows, columns = burn_times(opened.load())
    except (OSError, ValueError) as error:
        raise DomainError(f"No burn_time can be read from the grid: {error}", field="labels") from error
    latitude, longitude = np.meshgrid(rows, columns, indexing="ij")
    return labels_table(latitude, longitude, times)


def labels_table(latitude_deg: NDArray, longitude_deg: NDArray, burn_time: NDArray) -> pd.DataFrame:
    """A labels table from arrays of one shape; ``burn_time`` datetime, NaT where unburned."""
    return pd.DataFrame(
        {
            "longitude_deg": np.ravel(longitude_deg),
            "latitude_deg": np.ravel(latitude_deg),
            "burn_time": np.ravel(burn_time),
        }
    )


def _unit_vectors(latitude_deg: NDArray, longitude_deg: NDArray) -> NDArray[np.float64]:
    latitude, longitude = np.deg2rad(latitude_deg), np.deg2rad(longitude_deg)
    cosine = np.cos(latitude)
    return np.stack([cosine * np.cos(longitude), cosine * np.sin(longitude), np.sin(latitude)], axis=1)
