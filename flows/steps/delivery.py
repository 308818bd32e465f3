"""Which measurements are on the ground by the end of a cycle: the cut-off for what the satellites saw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd


@dataclass(frozen=True)
class SortedPoints:
    """Specular points (contract ``specular_points``): delivered in nominal mode, in raw-IF mode, and not yet.

    ``nominal_down_at`` says when each of the nominal ones came down.
    """

    nominal: pd.DataFrame
    raw_if: pd.DataFrame
    pending: pd.DataFrame
    nominal_down_at: pd.Series[Any]


def sort_points(
    points: pd.DataFrame, as_run: pd.DataFrame, contacts: pd.DataFrame, end: pd.Timestamp, level1_latency_s: int
) -> SortedPoints:
    """Sort points by whether they were delivered by ``end``.

    Nominal data are of the four points that the receiver tracks (column ``nominal``), an image holds every point in the
    antenna beams (column ``in_beam``); a table without these columns holds only points that count.

    Nominal data come down whole at the satellite's next contact and are level-1 data ``level1_latency_s`` later. A
    second of raw-IF data is delivered when its image's downlink is done. A point waits (``pending``) while its nominal
    data or its stored image have still to come; ``nominal_due`` remembers which of the two it still owes, and
    ``nominal_down_at`` when its nominal data came down, if that was before ``end`` and they were still in processing.
    """
    due = points["nominal_due"] if "nominal_due" in points else pd.Series(True, index=points.index)
    due = due.astype("boolean").fillna(True).astype(bool)
    due &= points["nominal"].astype(bool) if "nominal" in points else True
    down_at = nominal_delivery(points, contacts)
    if "nominal_down_at" in points:
        down_at = points["nominal_down_at"].astype(down_at.dtype).fillna(down_at)
    arrived = due & (down_at + pd.Timedelta(seconds=level1_latency_s) <= end)
    seen = points["in_beam"].astype(bool) if "in_beam" in points else True
    down = _in_images(points, as_run[as_run["status"] == "downlinked"]) & seen
    aboard = _in_images(points, as_run[as_run["status"] == "collected"]) & seen
    owing = due & ~arrived
    waits = owing | aboard
    pending = points[waits].assign(
        nominal_due=owing[waits], nominal_down_at=down_at[waits].where(down_at[waits] <= end)
    )
    plain = points.drop(columns=["nominal_due", "nominal_down_at"], errors="ignore")
    return SortedPoints(plain[arrived], plain[down], pending, down_at[arrived])


def nominal_delivery(points: pd.DataFrame, contacts: pd.DataFrame) -> pd.Series[Any]:
    """The end of the first contact that starts after each point was measured; NaT where none follows."""
    delivered = pd.Series(pd.NaT, index=points.index, dtype="datetime64[ms, UTC]")
    for satellite, own in points.groupby("satellite"):
        passes = contacts[contacts["satellite"] == satellite].sort_values("start")
        if passes.empty:
            continue
        following = np.searchsorted(passes["start"].to_numpy(), own["time"].to_numpy(), side="left")
        found = following < len(passes)
        delivered.loc[own.index[found]] = passes["end"].iloc[following[found]].to_numpy()
    return delivered


def _in_images(points: pd.DataFrame, images: pd.DataFrame) -> pd.Series[Any]:
    wanted = pd.MultiIndex.from_arrays([images["satellite"], images["start"]])
    have = pd.MultiIndex.from_arrays([points["satellite"], points["time"]])
    return pd.Series(have.isin(wanted), index=points.index)
