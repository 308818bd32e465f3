"""Which seconds of which contact may carry raw-IF data, and why others may not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pandas as pd

from services.planning.check.reading import Row, Window, offset, without
from services.planning.check.verdict import ViolationLog
from services.planning.options.rules import OperationRules

HORIZON_OPEN = math.inf


@dataclass(frozen=True)
class UsablePass:
    """A stretch of a contact that outages and bookings leave: [begin, end), with data from ``data_from`` on."""

    satellite: str
    station: str
    begin: float
    end: float
    data_from: float
    raw_if_s: int
    """Whole seconds of it that raw-IF data may take."""


def outage_windows(rules: OperationRules, origin: pd.Timestamp, satellite: str = "", station: str = "") -> list[Window]:
    """Outages of one satellite or one station."""
    return [
        (offset(o.start, origin), HORIZON_OPEN if o.end is None else offset(o.end, origin))
        for o in rules.outages
        if (satellite and o.satellite == satellite) or (station and o.station == station)
    ]


def usable_passes(contacts: pd.DataFrame, rules: OperationRules, origin: pd.Timestamp) -> list[UsablePass]:
    """Every contact less outages of its station and satellite, within its bookings where bookings are demanded."""
    passes = []
    for row in contacts.itertuples(index=False):
        name, station = str(row.satellite), str(row.station)
        pieces = [(offset(row.start, origin), offset(row.end, origin))]
        gaps = outage_windows(rules, origin, satellite=name) + outage_windows(rules, origin, station=station)
        pieces = without(pieces, gaps)
        if rules.booked is not None:
            mine = rules.booked[
                (rules.booked["satellite"].astype(str) == name) & (rules.booked["station"].astype(str) == station)
            ]
            slots = [(offset(a, origin), offset(b, origin)) for a, b in zip(mine["start"], mine["end"], strict=True)]
            pieces = [(max(a, x), min(b, y)) for a, b in pieces for x, y in slots if min(b, y) > max(a, x)]
        for begin, end in pieces:
            raw_if = math.floor((1.0 - rules.nominal_share) * (end - begin) + 1e-9)
            passes.append(UsablePass(name, station, begin, end, begin + rules.acquisition_s, raw_if))
    return passes


def check_contacts(
    commands: dict[str, dict[int, Row]], contacts: pd.DataFrame, passes: list[UsablePass], rules: OperationRules,
    origin: pd.Timestamp, frozen: set[tuple[str, int]], log: ViolationLog,
) -> None:  # fmt: skip
    """Downlinks only in usable seconds of a contact, one satellite per station, nominal data's share left alone."""
    inside = _seconds((str(r.satellite), str(r.station), offset(r.start, origin), offset(r.end, origin))
                      for r in contacts.itertuples(index=False))  # fmt: skip
    tracked = _seconds((p.satellite, p.station, p.begin, p.end) for p in passes)
    open_ = _seconds((p.satellite, p.station, p.data_from, p.end) for p in passes)
    serving: dict[tuple[str, int], str] = {}
    for name in sorted(commands):
        for second, row in commands[name].items():
            if row.command != "downlink":
                continue
            key = (name, str(row.station), second)
            if key not in inside:
                log.add("contact", name, second, f"downlink to {row.station} outside its contacts")
            elif key not in tracked:
                log.add(_why(key, rules, origin), name, second, f"the pass over {row.station} cannot be used here")
            elif key not in open_:
                log.add("acquisition", name, second, f"{row.station} is still acquiring the signal")
            other = serving.setdefault((str(row.station), second), name)
            if other != name:
                log.add("station", name, second, f"{row.station} already serves {other}")
    _check_nominal_share(commands, passes, rules, frozen, log)


def _seconds(windows: object) -> set[tuple[str, str, int]]:
    """(satellite, station, second) wholly inside any window."""
    found: set[tuple[str, str, int]] = set()
    for name, station, begin, end in windows:  # type: ignore[attr-defined]
        found.update((name, station, second) for second in range(math.ceil(begin), math.floor(end)))
    return found


def _why(key: tuple[str, str, int], rules: OperationRules, origin: pd.Timestamp) -> str:
    name, station, second = key
    gaps = outage_windows(rules, origin, satellite=name) + outage_windows(rules, origin, station=station)
    return "outage" if any(begin < second + 1 and end > second for begin, end in gaps) else "booking"


def _check_nominal_share(
    commands: dict[str, dict[int, Row]], passes: list[UsablePass], rules: OperationRules,
    frozen: set[tuple[str, int]], log: ViolationLog,
) -> None:  # fmt: skip
    if rules.nominal_share <= 0:
        return
    for p in passes:
        own = commands.get(p.satellite, {})
        used = 0
        for second in range(max(0, math.ceil(p.begin)), math.floor(p.end)):
            row = own.get(second)
            if row is None or row.command != "downlink" or row.station != p.station:
                continue
            used += 1
            if used > p.raw_if_s and (p.satellite, second) not in frozen:
                detail = f"raw-IF data take more than {p.raw_if_s} s of the pass over {p.station}"
                log.add("nominal", p.satellite, second, detail)
                break
