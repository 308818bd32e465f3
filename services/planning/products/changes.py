"""What is different from the previous plan, command by command, and why a command is gone."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd

from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem
from services.planning.timeline import collected_seconds

COLUMNS = ("satellite", "start", "end", "command", "station", "change", "reason")


def plan_changes(problem: PlanningProblem, timeline: Timeline, previous: pd.DataFrame | None) -> pd.DataFrame:
    """Rows of satellite, start, end (UTC), command, station, change (``kept``|``dropped``|``added``) and reason.

    Seconds of one kind in a row make one row. Without a previous plan there are none. Commands of the previous plan
    before the horizon are history and not listed.
    """
    if previous is None:
        return _table(problem, [], [])
    names = [limits.name for limits in problem.satellites]
    new = _lines(problem, timeline)
    old, away = _previous_lines(problem, previous)
    records: list[tuple[str, int, int, int, str, str]] = []
    for s, name in enumerate(names):
        same = (new[s] == old[s]) & (new[s] >= 0)
        for change, line, mask in (
            ("kept", new[s], same),
            ("dropped", old[s], (old[s] >= 0) & ~same),
            ("added", new[s], (new[s] >= 0) & ~same),
        ):
            reason = _reasons(problem, s, old[s]) if change == "dropped" else np.full(problem.horizon_s, "", object)
            records += [(name, *run, change, str(reason[run[0]])) for run in _runs(np.where(mask, line, -1), reason)]
    records += [
        (name, begin, end, line, "dropped", "satellite lost: it is in no table of this plan")
        for name, begin, end, line in away
    ]
    return _table(problem, records, _stations(problem, previous))


def change_counts(changes: pd.DataFrame) -> dict[str, dict[str, int]]:
    """Seconds kept, dropped and added, by command, and why seconds were dropped."""
    length = (changes["end"] - changes["start"]).dt.total_seconds().astype(int)
    counts: dict[str, dict[str, int]] = {}
    for change in ("kept", "dropped", "added"):
        mine = changes["change"] == change
        counts[change] = {
            f"{command}_s": int(length[mine & (changes["command"] == command)].sum())
            for command in ("collect", "downlink")
        }
    gone = changes["change"] == "dropped"
    counts["dropped_because"] = {
        str(reason): int(length[gone & (changes["reason"] == reason)].sum())
        for reason in sorted(changes.loc[gone, "reason"].unique())
    }
    return counts


def _lines(problem: PlanningProblem, timeline: Timeline) -> np.ndarray:
    """(satellites, seconds): 0 recording, 1 + station downlink, -1 nothing."""
    line = np.where(timeline.downlink >= 0, timeline.downlink.astype(np.int64) + 1, -1)
    line[collected_seconds(problem, timeline.images)] = 0
    return line


def _previous_lines(
    problem: PlanningProblem, previous: pd.DataFrame
) -> tuple[np.ndarray, list[tuple[str, int, int, int]]]:
    """The same for the previous plan (unknown stations count on from the known ones), and rows of lost satellites."""
    index = {limits.name: s for s, limits in enumerate(problem.satellites)}
    stations = {name: g for g, name in enumerate(_stations(problem, previous))}
    line = np.full(problem.sunlit.shape, -1, np.int64)
    away = []
    for row in previous.itertuples(index=False):
        begin = max(0, round((pd.Timestamp(row.start) - problem.horizon_start).total_seconds()))
        end = min(problem.horizon_s, round((pd.Timestamp(row.end) - problem.horizon_start).total_seconds()))
        if end <= begin:
            continue
        what = 0 if row.command == "collect" else 1 + stations[str(row.station)]
        if str(row.satellite) in index:
            line[index[str(row.satellite)], begin:end] = what
        else:
            away.append((str(row.satellite), begin, end, what))
    return line, away


def _stations(problem: PlanningProblem, previous: pd.DataFrame) -> list[str]:
    named = {str(name) for name in previous["station"].dropna().unique()}
    return [*problem.stations, *sorted(named - set(problem.stations))]


def _reasons(problem: PlanningProblem, s: int, old: np.ndarray) -> np.ndarray:
    """Why each second of the previous plan cannot stay, or that something better took its place."""
    reason = np.full(problem.horizon_s, "something else is worth more now", object)
    seen = np.zeros(problem.horizon_s, bool)
    seen[problem.images.second[problem.images.satellite == s]] = True
    seen[problem.frozen.second[problem.frozen.satellite == s]] = True
    visible = np.zeros((problem.horizon_s, 1 + int(max(old.max(initial=0), len(problem.stations)))), bool)
    for p in (p for p in problem.passes if p.satellite == s):
        visible[p.start_s : p.end_s, 1 + p.station] = True
    reason[(old == 0) & ~seen] = "no opportunity there any more"
    sending = np.flatnonzero(old > 0)
    lost = sending[~visible[sending, old[sending]]]
    reason[lost] = "contact lost or not usable"
    reason[sending[visible[sending, old[sending]]]] = "the station or the time serves another command now"
    early = np.arange(problem.horizon_s) < problem.commands_from()[s]
    reason[early & (old >= 0)] = "on board but cannot run: storage, battery, contact or outage"
    closed = ~problem.commandable[s] & ~early
    reason[closed & (old >= 0)] = "satellite out of service"
    return reason


def _runs(line: np.ndarray, reason: np.ndarray) -> list[tuple[int, int, int]]:
    """(begin, end, value) of the unbroken runs of one value and one reason, where the value is not -1."""
    codes = pd.factorize(reason)[0] if len(reason) else np.zeros(0, np.int64)
    edges = np.flatnonzero((line[1:] != line[:-1]) | (codes[1:] != codes[:-1])) + 1
    bounds = [0, *edges.tolist(), len(line)]
    return [(b, e, int(line[b])) for b, e in pairwise(bounds) if e > b and line[b] >= 0]


def _table(
    problem: PlanningProblem, records: list[tuple[str, int, int, int, str, str]], stations: list[str]
) -> pd.DataFrame:
    records = sorted(records, key=lambda r: (r[0], r[1], r[4]))
    place = problem.horizon_start
    return pd.DataFrame({
        "satellite": pd.Series([r[0] for r in records], dtype="object"),
        "start": place + pd.to_timedelta([r[1] for r in records], unit="s"),
        "end": place + pd.to_timedelta([r[2] for r in records], unit="s"),
        "command": pd.Series(["collect" if r[3] == 0 else "downlink" for r in records], dtype="object"),
        "station": pd.Series(["" if r[3] == 0 else stations[r[3] - 1] for r in records], dtype="object"),
        "change": pd.Series([r[4] for r in records], dtype="object"),
        "reason": pd.Series([r[5] for r in records], dtype="object"),
    }, columns=list(COLUMNS))  # fmt: skip
