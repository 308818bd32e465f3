"""The command file of a satellite: time-tagged rows that a person can read and a program can parse."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem
from services.planning.products.outcomes import first_observers
from services.planning.timeline import battery_wh, collected_seconds, stored_images
from shared.figures import footer

HEADER = ("number", "start_utc", "end_utc", "duration_s", "command", "station", "pointing", "images", "first_image_id",
          "targets_first_seen", "active_target_ids", "cycle", "uplink_contact_utc", "source", "stored_images_after",
          "battery_wh_after")  # fmt: skip
NAMED_TARGETS = 8


def command_files(problem: PlanningProblem, timeline: Timeline, attributes: Mapping[str, Any]) -> dict[str, str]:
    """Satellite -> text of its command file: a row per recording (unbroken collects) and per unbroken downlink.

    Lines that begin with ``#`` say what the file is and rests on. ``source``: ``new``, or ``previous`` for commands
    that are on board already.
    """
    first = first_observers(problem, timeline.images)
    profile = (
        stored_images(problem, timeline.images, timeline.downlink),
        battery_wh(problem, timeline.images, timeline.downlink),
    )
    lines = _lines(problem, timeline)
    return {
        limits.name: _file(problem, timeline, s, lines[s], first, (profile[0][s], profile[1][s]), attributes)
        for s, limits in enumerate(problem.satellites)
    }


def _lines(problem: PlanningProblem, timeline: Timeline) -> np.ndarray:
    """(satellites, seconds, 2): recording 0 + pointing, downlink 1000 + station, -1 idle; and whether frozen."""
    what = np.where(timeline.downlink >= 0, timeline.downlink.astype(np.int64) + 1000, -1)
    what[collected_seconds(problem, timeline.images)] = 0
    own = problem.images
    what[own.satellite[timeline.images], own.second[timeline.images]] = own.pointing_of()[timeline.images]
    old = problem.frozen.downlink >= 0
    old[problem.frozen.satellite, problem.frozen.second] = True
    return np.stack([what, old], axis=-1)


def _file(
    problem: PlanningProblem, timeline: Timeline, s: int, line: np.ndarray, first: np.ndarray,
    profile: tuple[np.ndarray, np.ndarray], attributes: Mapping[str, Any],
) -> str:  # fmt: skip
    text = io.StringIO()
    begin = problem.horizon_start
    text.write(f"# commands of {problem.satellites[s].name}, {begin:%Y-%m-%dT%H:%M:%SZ} + {problem.horizon_s} s, UTC\n")
    text.write(f"# {footer(attributes)}\n")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(HEADER)
    edges = np.flatnonzero((line[1:] != line[:-1]).any(axis=1)) + 1
    number = 0
    for start, end in pairwise([0, *edges.tolist(), problem.horizon_s]):
        if line[start, 0] >= 0:
            number += 1
            rows.writerow([number, *_row(problem, timeline, s, start, end, line[start], first, profile)])
    return text.getvalue()


def _row(
    problem: PlanningProblem, timeline: Timeline, s: int, begin: int, end: int, kind: np.ndarray, first: np.ndarray,
    profile: tuple[np.ndarray, np.ndarray],
) -> list[Any]:  # fmt: skip
    collect = kind[0] < 1000
    own, old = problem.images, problem.frozen
    mine = timeline.images[(own.satellite[timeline.images] == s)]
    mine = mine[(own.second[mine] >= begin) & (own.second[mine] < end)] if collect else mine[:0]
    mine = mine[np.argsort(own.second[mine], kind="stable")]
    seen = np.flatnonzero(np.isin(first, mine)) if len(mine) else np.zeros(0, np.int64)
    active = problem.targets.target_id[seen[problem.targets.active[seen]]]
    foreign = old.image_id[(old.satellite == s) & (old.second >= begin) & (old.second < end)] if collect else []
    ids = [*own.image_id[mine].tolist(), *(int(i) for i in foreign)]
    contact = problem.uplink_contact[s]
    named = " ".join(map(str, active[:NAMED_TARGETS].tolist())) + (" ..." if len(active) > NAMED_TARGETS else "")
    return [
        _time(problem, begin), _time(problem, end), end - begin, "collect" if collect else "downlink",
        "" if collect else problem.stations[kind[0] - 1000],
        problem.pointings[kind[0]] if collect and problem.pointings else "", end - begin if collect else "",
        ids[0] if ids else "", len(seen) if collect else "", named,
        int(np.searchsorted(cycle_ends(problem, s), begin, side="right")),
        "" if contact is None or kind[1] else f"{contact:%Y-%m-%dT%H:%M:%SZ}", "previous" if kind[1] else "new",
        int(profile[0][end - 1]), f"{profile[1][end - 1]:.3f}",
    ]  # fmt: skip


def _time(problem: PlanningProblem, second: int) -> str:
    return f"{problem.horizon_start + np.timedelta64(second, 's'):%Y-%m-%dT%H:%M:%SZ}"
