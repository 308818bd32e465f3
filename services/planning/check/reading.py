"""The contract tables as the replay reads them: plain rows, sets and intervals in seconds from the horizon's start."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from services.planning.check.verdict import ViolationLog

Window = tuple[float, float]


@dataclass(frozen=True)
class Row:
    """One command of the schedule; seconds are half-open."""

    satellite: str
    begin: int
    end: int
    command: str
    image: int | None
    station: str | None
    pointing: str | None


@dataclass(frozen=True)
class Image:
    """Where an image of the opportunities stands."""

    satellite: str
    second: float
    pointing: str | None


def offset(moment: Any, origin: pd.Timestamp) -> float:
    """Seconds from ``origin``."""
    return float((pd.Timestamp(moment) - origin) / pd.Timedelta(seconds=1))


def read_rows(
    schedule: pd.DataFrame, origin: pd.Timestamp, horizon_s: int, satellites: list[str], log: ViolationLog
) -> list[Row]:
    """The schedule's usable rows; unusable ones are logged as ``command`` or ``interval``."""
    rows = []
    for row in schedule.itertuples(index=False):
        begin, end = offset(row.start, origin), offset(row.end, origin)
        name, at = str(row.satellite), math.floor(begin)
        image = None if pd.isna(row.image_id) else int(row.image_id)
        station = None if pd.isna(row.station) else str(row.station)
        pointing = getattr(row, "pointing", None)
        if name not in satellites:
            log.add("command", name, at, "unknown satellite")
        elif begin != math.floor(begin) or end != math.floor(end):
            log.add("interval", name, at, "not on whole seconds from horizon_start")
        elif not 0 <= begin < end <= horizon_s:
            log.add("interval", name, at, f"[{begin:g}, {end:g}) is empty or outside the horizon 0..{horizon_s}")
        elif row.command == "collect" and image is None:
            log.add("command", name, at, "a collect names no image")
        elif row.command == "collect" and end - begin != 1:
            log.add("interval", name, at, f"an image takes 1 s, not {end - begin:g}")
        elif row.command == "downlink" and station is None:
            log.add("command", name, at, "a downlink names no station")
        elif row.command not in ("collect", "downlink"):
            log.add("command", name, at, f"unknown command '{row.command}'")
        else:
            held = None if pointing is None or pd.isna(pointing) else str(pointing)
            rows.append(Row(name, int(begin), int(end), str(row.command), image, station, held))
    return rows


def read_images(opportunities: pd.DataFrame, origin: pd.Timestamp) -> dict[int, Image]:
    """Image id -> satellite, second and pointing."""
    heads = opportunities.drop_duplicates("image_id")
    seconds = (heads["time"] - origin) / pd.Timedelta(seconds=1)
    pointings = heads["pointing"] if "pointing" in heads else pd.Series([None] * len(heads))
    return {
        int(i): Image(str(s), float(t), None if pd.isna(p) else str(p))
        for i, s, t, p in zip(heads["image_id"], heads["satellite"], seconds, pointings, strict=True)
    }


def previous_seconds(
    previous: pd.DataFrame | None, origin: pd.Timestamp, horizon_s: int
) -> dict[tuple[str, int], tuple[str, str | None, int]]:
    """(satellite, second) -> (command, station, start of the row) of the previous schedule."""
    seconds: dict[tuple[str, int], tuple[str, str | None, int]] = {}
    if previous is None:
        return seconds
    for row in previous.itertuples(index=False):
        begin, end = round(offset(row.start, origin)), round(offset(row.end, origin))
        station = None if pd.isna(row.station) else str(row.station)
        for second in range(max(0, begin), min(horizon_s, end)):
            seconds[(str(row.satellite), second)] = (str(row.command), station, begin)
    return seconds


def dark_seconds(eclipses: pd.DataFrame, name: str, origin: pd.Timestamp, horizon_s: int) -> set[int]:
    """Seconds of which any part lies in umbra."""
    dark: set[int] = set()
    for row in eclipses[eclipses["satellite"].astype(str) == name].itertuples(index=False):
        kind = getattr(row, "kind", "umbra")
        if isinstance(kind, str) and kind == "penumbra":
            continue
        begin, end = offset(row.start, origin), offset(row.end, origin)
        if end > begin:
            dark.update(range(max(0, math.floor(begin)), min(horizon_s, math.ceil(end))))
    return dark


def without(pieces: list[Window], gaps: list[Window]) -> list[Window]:
    """What is left of ``pieces`` outside ``gaps``."""
    for gap_begin, gap_end in gaps:
        pieces = [
            part
            for begin, end in pieces
            for part in ((begin, min(end, gap_begin)), (max(begin, gap_end), end))
            if part[1] > part[0]
        ]
    return pieces


def first_seconds(
    spacecraft: Mapping[str, Mapping[str, Any]], uplinks: list[tuple[str, Window]], release_s: float | None,
    frozen_s: float | None,
) -> dict[str, float]:  # fmt: skip
    """From when each satellite may start new commands: end of its first pass from release on, plus margin."""
    first = {}
    for name, fields in spacecraft.items():
        own = sorted(window for satellite, window in uplinks if satellite == name and window[0] >= (release_s or 0.0))
        begin = 0.0
        if release_s is not None:
            begin = own[0][1] + float(fields["uplink_margin_s"]) if own else math.inf
        first[name] = max(begin, frozen_s or 0.0)
    return first
