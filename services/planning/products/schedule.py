"""The emitted schedule table: one row per image, one per unbroken downlink run."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem

COLUMNS = ("satellite", "start", "end", "command", "image_id", "station", "cycle", "uplink_contact")


Record = tuple[int, int, int, str, int | None, str | None, bool, int]
"""Satellite, begin, end, command, image id, station, whether it is still the previous plan's, pointing (-1: none)."""


def schedule_table(problem: PlanningProblem, timeline: Timeline, previous: pd.DataFrame | None = None) -> pd.DataFrame:
    """Rows of the ``schedule`` contract in order of satellite and time; frozen and new downlinks stay apart.

    Frozen rows keep the ``uplink_contact`` that they had in the ``previous`` schedule.
    """
    records: list[Record] = []
    own = problem.images
    held = own.pointing_of()
    for image in timeline.images[~np.isin(timeline.images, problem.frozen_images)]:
        second, image_id = int(own.second[image]), int(own.image_id[image])
        place = int(held[image])
        records.append((int(own.satellite[image]), second, second + 1, "collect", image_id, None, False, place))
    frozen = problem.frozen
    kept = np.full(len(frozen.second), -1, np.int64) if frozen.pointing is None else frozen.pointing
    columns = (frozen.satellite, frozen.second, frozen.image_id, kept)
    for satellite, second, image_id, place in zip(*columns, strict=True):
        begin = int(second)
        records.append((int(satellite), begin, begin + 1, "collect", int(image_id), None, True, int(place)))
    for satellite in range(len(problem.satellites)):
        # a run ends where the station changes or where the previous plan's command meets the new one
        key = 2 * timeline.downlink[satellite].astype(np.int64) + (frozen.downlink[satellite] >= 0)
        edges = np.concatenate([[0], np.flatnonzero(key[1:] != key[:-1]) + 1, [len(key)]])
        for begin, end in pairwise(edges):
            station = int(timeline.downlink[satellite, begin])
            if station >= 0:
                old = bool(frozen.downlink[satellite, begin] >= 0)
                records.append((satellite, int(begin), int(end), "downlink", None, problem.stations[station], old, -1))
    records.sort(key=lambda record: (record[0], record[1]))
    table = _table(problem, records)
    old = np.array([record[6] for record in records], bool)
    if previous is not None and old.any():
        table.loc[old, "uplink_contact"] = _earlier_uplinks(table[old], previous)
    return table


def _earlier_uplinks(rows: pd.DataFrame, previous: pd.DataFrame) -> pd.Series:
    """The uplink of the command of the previous schedule that each row goes on with, by row."""
    uplinks = []
    for row in rows.itertuples():
        before = previous[(previous["satellite"] == row.satellite) & (previous["start"] <= row.start)]
        uplinks.append(before.sort_values("start")["uplink_contact"].iloc[-1])
    return pd.Series(uplinks, index=rows.index, dtype="datetime64[ms, UTC]")


def _table(problem: PlanningProblem, records: list[Record]) -> pd.DataFrame:
    satellite = np.array([record[0] for record in records], np.int64)
    begin, end = (np.array([record[i] for record in records], np.int64) for i in (1, 2))
    cycle = np.zeros(len(records), np.int32)
    for s in range(len(problem.satellites)):
        cycle[satellite == s] = np.searchsorted(cycle_ends(problem, s), begin[satellite == s], side="right")
    table = pd.DataFrame({
        "satellite": [problem.satellites[s].name for s in satellite],
        "start": problem.horizon_start + pd.to_timedelta(begin, unit="s"),
        "end": problem.horizon_start + pd.to_timedelta(end, unit="s"),
        "command": [record[3] for record in records],
        "image_id": pd.array([record[4] for record in records], "Int32"),
        "station": pd.array([record[5] for record in records], "string"),
        "cycle": cycle,
        "uplink_contact": pd.Series([problem.uplink_contact[s] for s in satellite], dtype="datetime64[ms, UTC]"),
    }, columns=list(COLUMNS))  # fmt: skip
    if problem.pointings:
        names = [problem.pointings[record[7]] if record[7] >= 0 else None for record in records]
        table["pointing"] = pd.array(names, "string")
    return table
