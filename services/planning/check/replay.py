"""`check-plan`: replay any schedule second by second against the contract, sharing no code with the solver.

Deliberately plain: one loop over seconds with counters, as a spacecraft would live it. It reads the contract tables
itself, and rounds contacts and eclipses itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from services.planning.check.commands import (
    Previous,
    check_images,
    check_unavailable,
    check_uplink,
    frozen_seconds,
    timeline,
    unavailable_windows,
)
from services.planning.check.living import OnBoard, live
from services.planning.check.passes import UsablePass, check_contacts, outage_windows, usable_passes
from services.planning.check.reading import (
    Row,
    dark_seconds,
    first_seconds,
    offset,
    previous_seconds,
    read_images,
    read_rows,
)
from services.planning.check.sequences import check_sequences
from services.planning.check.verdict import Verdict, ViolationLog
from services.planning.check.worth import (
    check_pins,
    dropped_images,
    fragile_targets,
    images_that_see,
    reachable_images,
    reward,
    worth_of,
)
from services.planning.options.rules import OperationRules


def replay(
    schedule: pd.DataFrame,
    opportunities: pd.DataFrame,
    targets: pd.DataFrame,
    contacts: pd.DataFrame,
    eclipses: pd.DataFrame,
    spacecraft: Mapping[str, Mapping[str, Any]],
    horizon_start: pd.Timestamp,
    horizon_s: int,
    release: pd.Timestamp | None = None,
    previous: pd.DataFrame | None = None,
    rules: OperationRules | None = None,
) -> Verdict:
    """Live through ``schedule`` and report the first breach of each rule.

    ``spacecraft`` maps a satellite to its fields of the spacecraft contract, flattened, with ``unavailable`` as pairs
    of seconds. Rules of the contract: ``interval``, ``command``, ``image``, ``repeat``, ``simultaneous``,
    ``unavailable``, ``uplink``, ``frozen``, ``contact``, ``station``, ``storage``, ``empty``, ``battery``; of the
    options: ``outage``, ``booking``, ``acquisition``, ``nominal``, ``min-collect``, ``mode-switch``, ``slew``,
    ``commands``, ``pinned``.
    """
    rules = rules or OperationRules()
    log = ViolationLog()
    satellites = sorted(set(spacecraft))
    rows = read_rows(schedule, horizon_start, horizon_s, satellites, log)
    images = read_images(opportunities, horizon_start)
    passes = usable_passes(contacts, rules, horizon_start)
    release_s = None if release is None else offset(release, horizon_start)
    until_s = None if rules.frozen_until is None else offset(rules.frozen_until, horizon_start)
    uplinks = [(p.satellite, (p.begin, p.end)) for p in passes]
    first = first_seconds(spacecraft, uplinks, release_s, until_s)
    before = previous_seconds(previous, horizon_start, horizon_s)
    kept = before if release is not None or until_s is not None else {}
    frozen = frozen_seconds(rows, kept, first)
    closed = unavailable_windows(
        spacecraft, {name: outage_windows(rules, horizon_start, satellite=name) for name in satellites}
    )
    commands = timeline(rows, log)
    check_images(rows, images, frozen, rules, log)
    check_uplink(rows, first, frozen, log)
    check_unavailable(commands, closed, horizon_s, log)
    check_contacts(commands, contacts, passes, rules, horizon_start, frozen, log)
    check_sequences(commands, images, spacecraft, rules, frozen, horizon_start, log)
    boards = _on_board(satellites, kept, first, commands, passes, closed)
    stored, charge = {}, {}
    for name in satellites:
        dark = dark_seconds(eclipses, name, horizon_start, horizon_s)
        own = commands.get(name, {})
        stored[name], charge[name] = live(name, own, dark, spacecraft[name], horizon_s, boards[name], log)
    collected = {row.image for row in rows if row.command == "collect" and row.image is not None}
    reachable = reachable_images(images, first, closed, frozen, horizon_s)
    check_pins(collected, opportunities, images, reachable, rules, log)
    worthwhile = reachable & images_that_see(opportunities, rules)  # giving up what nobody wants loses nothing
    dropped = dropped_images(commands, images, worthwhile, before, first)
    fragile = fragile_targets(collected, opportunities)
    return Verdict(
        log.ordered(), tuple(sorted(row.image for row in rows if row.command == "collect" and row.image is not None)),
        reward(collected, opportunities, targets, rules), stored, charge, dropped, dropped * rules.change_penalty,
        len(fragile), rules.fragile_discount * worth_of(fragile, targets, rules),
    )  # fmt: skip


def _on_board(
    satellites: list[str], kept: Previous, first: Mapping[str, float], commands: Mapping[str, Mapping[int, Row]],
    passes: list[UsablePass], closed: Mapping[str, list[tuple[str, tuple[float, float]]]],
) -> dict[str, OnBoard]:  # fmt: skip
    """What each satellite still has on board, and where a lost contact, station or satellite keeps it from running."""
    serving = {
        (row.station, second): name
        for name, own in commands.items()
        for second, row in own.items()
        if row.command == "downlink"
    }
    boards = {}
    for name in satellites:
        own = {
            second: (command, station)
            for (satellite, second), (command, station, begun) in kept.items()
            if satellite == name and begun <= second < first[name]
        }
        visible = [(p.station, p.data_from, p.end) for p in passes if p.satellite == name]
        blocked = {s for s in own if any(begin < s + 1 and end > s for _, (begin, end) in closed[name])}
        for second, (command, station) in own.items():
            seen = any(g == station and begin <= second and second + 1 <= end for g, begin, end in visible)
            if command == "downlink" and (not seen or serving.get((station, second), name) != name):
                blocked.add(second)
        boards[name] = OnBoard(own, frozenset(blocked))
    return boards
