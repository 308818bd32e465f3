"""How long ago each place was last seen well, from the table of good observations."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization import plain_columns
from shared.errors import DomainError

Array = npt.NDArray[np.float64]
EARTH_RADIUS_KM = 6371.0
COLUMNS = ("longitude_deg", "latitude_deg", "time")


def check_observed(table: pd.DataFrame) -> pd.DataFrame:
    """The table with its times in UTC; DomainError naming a missing column or a place that is none."""
    for name in COLUMNS:
        if name not in table.columns:
            raise DomainError(
                f"The table of observations lacks '{name}'.", field="observed", value=name, accepted=", ".join(COLUMNS)
            )
    longitude, latitude = (plain_columns.numbers(table, name, "observed") for name in COLUMNS[:2])
    places = np.stack([longitude, latitude], axis=1)
    bad = ~np.isfinite(places).all(axis=1) | (np.abs(places[:, 0]) > 180) | (np.abs(places[:, 1]) > 90)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise DomainError(
            f"Row {row} of the observations has no valid place.", field="observed", value=str(places[row])
        )
    time = plain_columns.times(table, "time", "observed")
    return table.assign(longitude_deg=longitude, latitude_deg=latitude, time=time)


def _unit_vectors(longitude_deg: Array, latitude_deg: Array) -> Array:
    longitude, latitude = np.radians(longitude_deg), np.radians(latitude_deg)
    return np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )


def age_h(
    longitude_deg: Array, latitude_deg: Array, observed: pd.DataFrame | None, time: pd.Timestamp, reach_km: float
) -> Array:
    """Hours since the latest good observation within ``reach_km`` of each place; NaN where there was none.

    Observations after ``time`` are not yet known and left out.
    """
    ages = np.full(len(longitude_deg), np.nan)
    if observed is None or not len(longitude_deg):
        return ages
    from scipy.spatial import cKDTree

    known = observed[observed["time"] <= time]
    if known.empty:
        return ages
    seen = _unit_vectors(known["longitude_deg"].to_numpy(), known["latitude_deg"].to_numpy())
    age = (time - known["time"]).dt.total_seconds().to_numpy() / 3600
    chord = 2 * np.sin(reach_km / EARTH_RADIUS_KM / 2)
    near = cKDTree(seen).query_ball_point(_unit_vectors(longitude_deg, latitude_deg), chord)
    for index, rows in enumerate(near):
        if rows:
            ages[index] = age[rows].min()
    return ages
