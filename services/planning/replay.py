"""`check-plan`: replay any schedule second by second against the contract, sharing no code with the solver.

Deliberately plain: one loop over seconds with counters, as a spacecraft would live it. It reads the contract tables
itself, and rounds contacts and eclipses itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

ENERGY_TOLERANCE_WH = 1e-9


@dataclass(frozen=True)
class Violation:
    """A broken rule: which, by which satellite, at which second from horizon_start, and in words."""

    rule: str
    satellite: str
    second: int
    detail: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.satellite} at second {self.second}: {self.detail}"


@dataclass(frozen=True)
class Verdict:
    """``violations`` holds the first of every broken rule, in order of time; ``images`` those collected."""

    violations: tuple[Violation, ...]
    images: tuple[int, ...]
    objective: float
    stored_at_end: dict[str, int] = field(default_factory=dict)
    battery_at_end_wh: dict[str, float] = field(default_factory=dict)

    @property
    def valid(self) -> bool:
        return not self.violations


class _Log:
    """Keeps the earliest violation of every rule."""

    def __init__(self) -> None:
        self.first: dict[str, Violation] = {}

    def add(self, rule: str, satellite: str, second: int, detail: str) -> None:
        known = self.first.get(rule)
        if known is None or (second, satellite) < (known.second, known.satellite):
            self.first[rule] = Violation(rule, satellite, second, detail)

    def ordered(self) -> tuple[Violation, ...]:
        return tuple(sorted(self.first.values(), key=lambda v: (v.second, v.satellite, v.rule)))


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
) -> Verdict:
    """Live through ``schedule`` and report the first breach of each rule.

    ``spacecraft`` maps a satellite to its fields of the spacecraft contract, flattened, with ``unavailable`` as pairs
    of seconds. Rules: ``interval``, ``command``, ``image``, ``repeat``, ``simultaneous``, ``unavailable``, ``uplink``,
    ``contact``, ``station``, ``storage``, ``empty``, ``battery``.
    """
    log = _Log()
    satellites = sorted(set(spacecraft))
    rows = _rows(schedule, horizon_start, horizon_s, satellites, log)
    kept = _previous_seconds(previous, horizon_start, horizon_s) if release is not None else {}
    first = _first_seconds(contacts, spacecraft, horizon_start, release)
    _check_images(rows, opportunities, horizon_start, kept, first, log)
    commands = _timeline(rows, log)
    _check_release(rows, commands, first, kept, spacecraft, log)
    _check_contacts(commands, contacts, horizon_start, log)
    stored, charge = {}, {}
    for name in satellites:
        dark = _dark_seconds(eclipses, name, horizon_start, horizon_s)
        stored[name], charge[name] = _live(name, commands.get(name, {}), dark, spacecraft[name], horizon_s, log)
    images = tuple(sorted(row["image"] for row in rows if row["command"] == "collect" and row["image"] is not None))
    return Verdict(log.ordered(), images, _reward(set(images), opportunities, targets), stored, charge)


def _offset(moment: Any, origin: pd.Timestamp) -> float:
    return (pd.Timestamp(moment) - origin) / pd.Timedelta(seconds=1)


def _rows(
    schedule: pd.DataFrame, origin: pd.Timestamp, horizon_s: int, satellites: list[str], log: _Log
) -> list[dict[str, Any]]:
    rows = []
    for row in schedule.itertuples(index=False):
        begin, end = _offset(row.start, origin), _offset(row.end, origin)
        name, at = str(row.satellite), math.floor(begin)
        if name not in satellites:
            log.add("command", name, at, "unknown satellite")
            continue
        if begin != math.floor(begin) or end != math.floor(end):
            log.add("interval", name, at, "not on whole seconds from horizon_start")
            continue
        if not 0 <= begin < end <= horizon_s:
            log.add("interval", name, at, f"[{begin:g}, {end:g}) is empty or outside the horizon 0..{horizon_s}")
            continue
        image = None if pd.isna(row.image_id) else int(row.image_id)
        station = None if pd.isna(row.station) else str(row.station)
        if row.command == "collect" and image is None:
            log.add("command", name, at, "a collect names no image")
        elif row.command == "collect" and end - begin != 1:
            log.add("interval", name, at, f"an image takes 1 s, not {end - begin:g}")
        elif row.command == "downlink" and station is None:
            log.add("command", name, at, "a downlink names no station")
        elif row.command not in ("collect", "downlink"):
            log.add("command", name, at, f"unknown command '{row.command}'")
        else:
            rows.append({
                "satellite": name, "begin": int(begin), "end": int(end), "command": str(row.command), "image": image,
                "station": station,
            })  # fmt: skip
    return rows


def _previous_seconds(
    previous: pd.DataFrame | None, origin: pd.Timestamp, horizon_s: int
) -> dict[tuple[str, int], tuple[str, str | None, int]]:
    """(satellite, second) -> (command, station, start of the row) of the previous schedule."""
    seconds: dict[tuple[str, int], tuple[str, str | None, int]] = {}
    if previous is None:
        return seconds
    for row in previous.itertuples(index=False):
        begin, end = round(_offset(row.start, origin)), round(_offset(row.end, origin))
        station = None if pd.isna(row.station) else str(row.station)
        for second in range(max(0, begin), min(horizon_s, end)):
            seconds[(str(row.satellite), second)] = (str(row.command), station, begin)
    return seconds


def _first_seconds(
    contacts: pd.DataFrame, spacecraft: Mapping[str, Mapping[str, Any]], origin: pd.Timestamp, release: Any
) -> dict[str, float]:
    """From when each satellite may start new commands: end of its first contact from release on, plus margin."""
    if release is None:
        return dict.fromkeys(spacecraft, 0.0)
    at = _offset(release, origin)
    first: dict[str, float] = {}
    best: dict[str, tuple[float, float]] = {}
    for row in contacts.itertuples(index=False):
        begin, end = _offset(row.start, origin), _offset(row.end, origin)
        name = str(row.satellite)
        if begin >= at and (name not in best or (begin, end) < best[name]):
            best[name] = (begin, end)
    for name, fields in spacecraft.items():
        first[name] = best[name][1] + float(fields["uplink_margin_s"]) if name in best else math.inf
    return first


def _check_images(
    rows: list[dict[str, Any]], opportunities: pd.DataFrame, origin: pd.Timestamp,
    kept: dict[tuple[str, int], tuple[str, str | None, int]], first: dict[str, float], log: _Log,
) -> None:  # fmt: skip
    """A collect must be an image of the opportunities, at its satellite and second, and collected once."""
    heads = opportunities.drop_duplicates("image_id")
    moments = [_offset(moment, origin) for moment in heads["time"]]
    known = {
        int(i): (str(s), t) for i, s, t in zip(heads["image_id"], heads["satellite"].astype(str), moments, strict=True)
    }
    seen: set[int] = set()
    for row in sorted((r for r in rows if r["command"] == "collect"), key=lambda r: r["begin"]):
        name, second, image = row["satellite"], row["begin"], row["image"]
        frozen = second < first[name] and kept.get((name, second), ("", None, 0))[0] == "collect"
        if image not in known:
            if not frozen:
                log.add("image", name, second, f"image {image} is not among the opportunities")
        elif known[image] != (name, float(second)):
            log.add("image", name, second, f"image {image} is {known[image][0]} at second {known[image][1]:g}")
        if image in seen:
            log.add("repeat", name, second, f"image {image} is collected twice")
        seen.add(image)


def _timeline(rows: list[dict[str, Any]], log: _Log) -> dict[str, dict[int, dict[str, Any]]]:
    """Command of every satellite-second; a second holds one."""
    commands: dict[str, dict[int, dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda r: (r["satellite"], r["begin"], r["end"])):
        own = commands.setdefault(row["satellite"], {})
        for second in range(row["begin"], row["end"]):
            if second in own:
                what = f"{own[second]['command']} and {row['command']}"
                log.add("simultaneous", row["satellite"], second, f"{what} in one second")
            own[second] = row
    return commands


def _check_release(
    rows: list[dict[str, Any]], commands: dict[str, dict[int, dict[str, Any]]], first: dict[str, float],
    kept: dict[tuple[str, int], tuple[str, str | None, int]], spacecraft: Mapping[str, Mapping[str, Any]], log: _Log,
) -> None:  # fmt: skip
    """New commands start after the uplink; earlier ones are the previous plan's. None while unavailable."""
    for row in rows:
        name = row["satellite"]
        if row["begin"] < first[name]:
            for second in range(row["begin"], row["end"]):
                command, station, begun = kept.get((name, second), ("", None, 0))
                if command != row["command"] or station != row["station"] or begun >= first[name]:
                    detail = f"a new {row['command']} before the first contact after release allows it"
                    log.add("uplink", name, second, detail)
                    break
    for name, own in commands.items():
        for begin, end in spacecraft[name]["unavailable"]:
            for second in range(max(0, math.floor(begin)), math.ceil(end)):
                if second in own:
                    log.add("unavailable", name, second, f"{own[second]['command']} while unavailable")
                    break


def _check_contacts(
    commands: dict[str, dict[int, dict[str, Any]]], contacts: pd.DataFrame, origin: pd.Timestamp, log: _Log
) -> None:
    """Downlinks only in seconds wholly inside a contact, one satellite per station."""
    inside: set[tuple[str, str, int]] = set()
    for row in contacts.itertuples(index=False):
        begin, end = math.ceil(_offset(row.start, origin)), math.floor(_offset(row.end, origin))
        inside.update((str(row.satellite), str(row.station), second) for second in range(begin, end))
    serving: dict[tuple[str, int], str] = {}
    for name in sorted(commands):
        for second, row in commands[name].items():
            if row["command"] != "downlink":
                continue
            if (name, row["station"], second) not in inside:
                log.add("contact", name, second, f"downlink to {row['station']} outside its contacts")
            other = serving.setdefault((row["station"], second), name)
            if other != name:
                log.add("station", name, second, f"{row['station']} already serves {other}")


def _dark_seconds(eclipses: pd.DataFrame, name: str, origin: pd.Timestamp, horizon_s: int) -> set[int]:
    """Seconds of which any part lies in umbra."""
    dark: set[int] = set()
    for row in eclipses[eclipses["satellite"].astype(str) == name].itertuples(index=False):
        kind = getattr(row, "kind", "umbra")
        if isinstance(kind, str) and kind == "penumbra":
            continue
        begin, end = _offset(row.start, origin), _offset(row.end, origin)
        if end > begin:
            dark.update(range(max(0, math.floor(begin)), min(horizon_s, math.ceil(end))))
    return dark


def _live(
    name: str, own: dict[int, dict[str, Any]], dark: set[int], craft: Mapping[str, Any], horizon_s: int, log: _Log
) -> tuple[int, float]:
    """Storage and battery of one satellite through the horizon; returns both at its end."""
    stored, progress = int(craft["stored_images_initial"]), 0
    battery = float(craft["battery_initial_wh"])
    for second in range(horizon_s):
        power = (0.0 if second in dark else craft["generation_w"]) - craft["nominal_w"]
        row = own.get(second)
        if row is not None and row["command"] == "collect":
            power -= craft["collect_w"]
            stored += 1
            if stored > craft["storage_images"]:
                log.add("storage", name, second, f"{stored} images in a store of {craft['storage_images']}")
        elif row is not None:
            power -= craft["downlink_w"]
            if stored <= 0:
                log.add("empty", name, second, "downlink with empty storage")
            else:
                progress += 1
                if progress == craft["downlink_s_per_image"]:
                    stored, progress = stored - 1, 0
        battery = min(craft["battery_capacity_wh"], battery + power / 3600.0)
        if battery < craft["battery_min_wh"] - ENERGY_TOLERANCE_WH:
            log.add("battery", name, second, f"{battery:.4f} Wh is below the floor of {craft['battery_min_wh']:g} Wh")
    return stored, battery


def _reward(images: set[int], opportunities: pd.DataFrame, targets: pd.DataFrame) -> float:
    """Equation 1: each observed target once, active ones tenfold."""
    observed = set(opportunities.loc[opportunities["image_id"].isin(images), "target_id"].tolist())
    total = 0.0
    for target, kind, priority in zip(targets["target_id"], targets["kind"], targets["priority"], strict=True):
        if target in observed:
            total += (10.0 if str(kind) == "active" else 1.0) * float(priority)
    return total
