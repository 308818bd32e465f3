"""Rules about single commands: what is collected, one command a second, uplink, windows without commands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from services.planning.check.reading import Image, Row, Window
from services.planning.check.verdict import ViolationLog
from services.planning.options.rules import OperationRules

Previous = Mapping[tuple[str, int], tuple[str, str | None, int]]


def frozen_seconds(rows: list[Row], kept: Previous, first: Mapping[str, float]) -> set[tuple[str, int]]:
    """Satellite-seconds in which the schedule goes on with a command of the previous plan."""
    frozen = set()
    for row in rows:
        for second in range(row.begin, row.end):
            command, station, begun = kept.get((row.satellite, second), ("", None, 0))
            if command == row.command and station == row.station and begun < first[row.satellite]:
                frozen.add((row.satellite, second))
    return frozen


def check_images(
    rows: list[Row], images: Mapping[int, Image], frozen: set[tuple[str, int]], rules: OperationRules,
    log: ViolationLog,
) -> None:  # fmt: skip
    """A collect must be an image of the opportunities, at its satellite and second, and collected once.

    Where recordings have a minimum length, seconds that see no target may fill them up.
    """
    seen: set[int] = set()
    for row in sorted((r for r in rows if r.command == "collect"), key=lambda r: r.begin):
        name, second, image = row.satellite, row.begin, row.image
        assert image is not None
        known = images.get(image)
        if known is None:
            if (name, second) not in frozen and rules.min_collect_s <= 1:
                log.add("image", name, second, f"image {image} is not among the opportunities")
        elif (known.satellite, known.second) != (name, float(second)):
            log.add("image", name, second, f"image {image} is {known.satellite} at second {known.second:g}")
        if image in seen:
            log.add("repeat", name, second, f"image {image} is collected twice")
        seen.add(image)


def timeline(rows: list[Row], log: ViolationLog) -> dict[str, dict[int, Row]]:
    """Command of every satellite-second; a second holds one."""
    commands: dict[str, dict[int, Row]] = {}
    for row in sorted(rows, key=lambda r: (r.satellite, r.begin, r.end)):
        own = commands.setdefault(row.satellite, {})
        for second in range(row.begin, row.end):
            if second in own:
                what = f"{own[second].command} and {row.command}"
                log.add("simultaneous", row.satellite, second, f"{what} in one second")
            own[second] = row
    return {name: dict(sorted(own.items())) for name, own in commands.items()}


def check_uplink(rows: list[Row], first: Mapping[str, float], frozen: set[tuple[str, int]], log: ViolationLog) -> None:
    """New commands start after the uplink; earlier ones are the previous plan's."""
    for row in rows:
        if row.begin >= first[row.satellite]:
            continue
        new = [second for second in range(row.begin, row.end) if (row.satellite, second) not in frozen]
        if new:
            log.add("uplink", row.satellite, new[0], f"a new {row.command} before commands can have been uplinked")


def check_unavailable(
    commands: Mapping[str, Mapping[int, Row]], windows: Mapping[str, list[tuple[str, Window]]], horizon_s: int,
    log: ViolationLog,
) -> None:  # fmt: skip
    """No command in any window (``unavailable`` or ``outage``) of its satellite."""
    for name, own in commands.items():
        for rule, (begin, end) in windows[name]:
            last = horizon_s if math.isinf(end) else min(horizon_s, math.ceil(end))
            for second in range(max(0, math.floor(begin)), last):
                if second in own:
                    log.add(rule, name, second, f"{own[second].command} while the satellite is out of service")
                    break


def unavailable_windows(
    spacecraft: Mapping[str, Mapping[str, Any]], outages: Mapping[str, list[Window]]
) -> dict[str, list[tuple[str, Window]]]:
    """Windows without commands of each satellite, with the rule that each belongs to."""
    return {
        name: [("unavailable", w) for w in fields["unavailable"]] + [("outage", w) for w in outages[name]]
        for name, fields in spacecraft.items()
    }
