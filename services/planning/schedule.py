"""The emitted schedule table: one row per image, one per unbroken downlink run."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem

COLUMNS = ("satellite", "start", "end", "command", "image_id", "station", "cycle", "uplink_contact")


def schedule_table(problem: PlanningProblem, timeline: Timeline) -> pd.DataFrame:
    """Rows of the ``schedule`` contract in order of satellite and time; frozen and new downlinks stay apart."""
    records: list[tuple[int, int, int, str, int | None, str | None]] = []
    own = problem.images
    for image in timeline.images[~np.isin(timeline.images, problem.frozen_images)]:
        second = int(own.second[image])
        records.append((int(own.satellite[image]), second, second + 1, "collect", int(own.image_id[image]), None))
    frozen = problem.frozen
    for satellite, second, image_id in zip(frozen.satellite, frozen.second, frozen.image_id, strict=True):
        records.append((int(satellite), int(second), int(second) + 1, "collect", int(image_id), None))
    for satellite in range(len(problem.satellites)):
        # a run ends where the station changes or where the previous plan's command meets the new one
        key = 2 * timeline.downlink[satellite].astype(np.int64) + (frozen.downlink[satellite] >= 0)
        edges = np.concatenate([[0], np.flatnonzero(key[1:] != key[:-1]) + 1, [len(key)]])
        for begin, end in pairwise(edges):
            station = int(timeline.downlink[satellite, begin])
            if station >= 0:
                records.append((satellite, int(begin), int(end), "downlink", None, problem.stations[station]))
    records.sort(key=lambda record: (record[0], record[1]))
    return _table(problem, records)


def _table(problem: PlanningProblem, records: list[tuple[int, int, int, str, int | None, str | None]]) -> pd.DataFrame:
    satellite = np.array([record[0] for record in records], np.int64)
    begin, end = (np.array([record[i] for record in records], np.int64) for i in (1, 2))
    cycle = np.zeros(len(records), np.int32)
    for s in range(len(problem.satellites)):
        cycle[satellite == s] = np.searchsorted(cycle_ends(problem, s), begin[satellite == s], side="right")
    return pd.DataFrame({
        "satellite": [problem.satellites[s].name for s in satellite],
        "start": problem.horizon_start + pd.to_timedelta(begin, unit="s"),
        "end": problem.horizon_start + pd.to_timedelta(end, unit="s"),
        "command": [record[3] for record in records],
        "image_id": pd.array([record[4] for record in records], "Int32"),
        "station": pd.array([record[5] for record in records], "string"),
        "cycle": cycle,
        "uplink_contact": pd.Series([problem.uplink_contact[s] for s in satellite], dtype="datetime64[ms, UTC]"),
    }, columns=list(COLUMNS))  # fmt: skip
