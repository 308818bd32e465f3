"""Rules about the order of commands: recordings, mode switches, pointings, commands a day."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import pandas as pd

from services.planning.check.reading import Image, Row
from services.planning.check.verdict import ViolationLog
from services.planning.options.rules import OperationRules


@dataclass(frozen=True)
class Run:
    """An unbroken command: a recording under one pointing, or a downlink to one station; [begin, end)."""

    command: str
    begin: int
    end: int
    place: str | None
    """Station of a downlink, pointing of a recording."""


def runs_of(own: Mapping[int, Row], images: Mapping[int, Image]) -> list[Run]:
    """The unbroken commands of one satellite in order of time."""
    runs: list[Run] = []
    for second in sorted(own):
        row = own[second]
        place = row.station if row.command == "downlink" else _pointing(row, images)
        last = runs[-1] if runs else None
        if last is not None and (last.command, last.end, last.place) == (row.command, second, place):
            runs[-1] = Run(last.command, last.begin, second + 1, place)
        else:
            runs.append(Run(row.command, second, second + 1, place))
    return runs


def _pointing(row: Row, images: Mapping[int, Image]) -> str | None:
    known = images.get(row.image) if row.image is not None else None
    return known.pointing if known is not None else row.pointing


def check_sequences(
    commands: Mapping[str, Mapping[int, Row]], images: Mapping[int, Image], spacecraft: Mapping[str, Mapping[str, Any]],
    rules: OperationRules, frozen: set[tuple[str, int]], origin: pd.Timestamp, log: ViolationLog,
) -> None:  # fmt: skip
    """Minimum recordings, mode switches, slews and command budgets; what the previous plan did is past mending."""
    for name, own in commands.items():
        runs = runs_of(own, images)
        _check_recordings(name, runs, rules, frozen, log)
        _check_switches(name, runs, rules, frozen, log)
        _check_slews(name, runs, spacecraft[name], frozen, log)
        _check_budget(name, runs, rules, frozen, origin, log)


def _check_recordings(
    name: str, runs: list[Run], rules: OperationRules, frozen: set[tuple[str, int]], log: ViolationLog
) -> None:
    for run in runs:
        short = run.command == "collect" and run.end - run.begin < rules.min_collect_s
        if short and not any((name, second) in frozen for second in range(run.begin, run.end)):
            detail = f"a recording of {run.end - run.begin} s, shorter than {rules.min_collect_s} s"
            log.add("min-collect", name, run.begin, detail)


def _check_switches(
    name: str, runs: list[Run], rules: OperationRules, frozen: set[tuple[str, int]], log: ViolationLog
) -> None:
    for before, after in pairwise(runs):
        idle = after.begin - before.end
        if before.command != after.command and idle < rules.mode_switch_s and (name, after.begin) not in frozen:
            detail = f"{after.command} {idle} s after a {before.command}; switching takes {rules.mode_switch_s} s"
            log.add("mode-switch", name, after.begin, detail)


def _check_slews(
    name: str, runs: list[Run], craft: Mapping[str, Any], frozen: set[tuple[str, int]], log: ViolationLog
) -> None:
    """One pointing at a time: turning from one to the next takes its seconds of the slew table."""
    table = craft.get("slew") or {}
    held, since = craft.get("pointing_initial"), 0
    for run in runs:
        if run.command != "collect" or run.place is None:
            continue
        if held is not None and held != run.place:
            needed = table.get(held, {}).get(run.place)
            if (needed is None or run.begin - since < needed) and (name, run.begin) not in frozen:
                allowed = "no slew allows" if needed is None else f"takes {needed} s, not {run.begin - since} s"
                log.add("slew", name, run.begin, f"{held} to {run.place}: {allowed}")
        held, since = run.place, run.end


def _check_budget(
    name: str, runs: list[Run], rules: OperationRules, frozen: set[tuple[str, int]], origin: pd.Timestamp,
    log: ViolationLog,
) -> None:  # fmt: skip
    if rules.max_commands_per_day is None:
        return
    counts: dict[pd.Timestamp, int] = {}
    for run in runs:
        day = (origin + pd.Timedelta(seconds=run.begin)).floor("D")
        counts[day] = counts.get(day, 0) + 1
        if counts[day] > rules.max_commands_per_day and (name, run.begin) not in frozen:
            detail = f"command {counts[day]} of {day:%Y-%m-%d}; at most {rules.max_commands_per_day} are allowed"
            log.add("commands", name, run.begin, detail)
