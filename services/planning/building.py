"""From contract tables to a `PlanningProblem`: validation, whole-second rounding, release and previous plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from services.planning.frozen import previous_commands
from services.planning.options.passes import OpenPass, open_passes, shared_with_nominal, usable_contacts
from services.planning.options.rules import OperationRules
from services.planning.options.wishes import changed_tables, pin
from services.planning.problem import (
    ACTIVE_WEIGHT,
    BoolArray,
    Frozen,
    Images,
    IntArray,
    PlanningProblem,
    SatelliteLimits,
    Targets,
)
from services.planning.validation import (
    check_horizon,
    check_limits,
    check_overlaps,
    check_slews,
    check_windows,
    seconds_from,
)
from shared.errors import DomainError


def build_problem(
    opportunities: pd.DataFrame,
    targets: pd.DataFrame,
    contacts: pd.DataFrame,
    eclipses: pd.DataFrame,
    spacecraft: Mapping[str, SatelliteLimits],
    horizon_start: pd.Timestamp,
    horizon_s: int,
    release: pd.Timestamp | None = None,
    previous: pd.DataFrame | None = None,
    rules: OperationRules | None = None,
) -> PlanningProblem:
    """Validate the inputs and cut them to whole seconds of the horizon.

    ``spacecraft`` maps every satellite name of the tables to its limits. With ``release`` a satellite accepts new
    commands from the end of its first contact that starts at or after release, plus its uplink margin; until then, and
    until ``rules.frozen_until``, the rows of ``previous`` run on. Raises `DomainError` naming the offending field.
    """
    rules = rules or OperationRules()
    check_horizon(horizon_s)
    for name, table in (("contacts", contacts), ("eclipses", eclipses)):
        check_windows(table, name)
    check_overlaps(contacts)
    names = tuple(sorted(set(opportunities["satellite"].astype(str)) | set(contacts["satellite"].astype(str))))
    satellites = tuple(check_limits(_out_of_service(spacecraft[name], rules, horizon_start)) for name in names)
    stations = tuple(sorted(set(contacts["station"].astype(str))))
    index = {name: position for position, name in enumerate(names)}
    changed = changed_tables({"opportunities": opportunities, "targets": targets}, rules)
    goals = pin(_targets(changed["targets"]), rules)
    usable = usable_contacts(contacts, rules)
    passes = _passes(usable, index, stations, horizon_start, horizon_s, rules)
    sunlit = _sunlit(eclipses, index, horizon_start, horizon_s)
    first_s, uplinks = _uplinks(usable, satellites, horizon_start, horizon_s, release)
    if rules.frozen_until is not None:
        until_s = math.ceil((rules.frozen_until - horizon_start).total_seconds())
        first_s = np.clip(np.maximum(first_s, until_s), 0, horizon_s)
    commandable = np.arange(horizon_s)[None, :] >= first_s[:, None]
    for row, limits in enumerate(satellites):
        for begin, end in limits.unavailable:
            last = horizon_s if math.isinf(end) else max(0, math.ceil(end))
            commandable[row, max(0, math.floor(begin)) : last] = False
    images, seen, pointings = _images(
        changed["opportunities"], index, goals, horizon_start, horizon_s, {x.pointing_initial for x in satellites}
    )
    if len(pointings) > 1:
        for limits in satellites:
            check_slews(limits.slew, pointings)
    problem = PlanningProblem(
        horizon_start, horizon_s, satellites, stations, tuple(p.whole() for p in passes), sunlit, commandable, images,
        goals, _no_frozen(len(names), horizon_s), uplinks, seen, first_s, pointings,
    )  # fmt: skip
    if previous is not None and len(previous) and (release is not None or rules.frozen_until is not None):
        problem = replace(problem, frozen=previous_commands(problem, previous, first_s))
    if rules.nominal_share > 0:
        problem = replace(problem, passes=shared_with_nominal(passes, problem.frozen))
    return _keep_commandable(problem)


def _out_of_service(limits: SatelliteLimits, rules: OperationRules, origin: pd.Timestamp) -> SatelliteLimits:
    """Limits with the outages of the satellite among its unavailable windows (an open end lies beyond any horizon)."""
    windows = tuple(
        (
            (outage.start - origin).total_seconds(),
            math.inf if outage.end is None else (outage.end - origin).total_seconds(),
        )
        for outage in rules.outages
        if outage.satellite == limits.name
    )
    return replace(limits, unavailable=limits.unavailable + windows) if windows else limits


def _no_frozen(satellites: int, horizon_s: int) -> Frozen:
    empty = np.zeros(0, np.int64)
    return Frozen(empty, empty, empty, empty, np.full((satellites, horizon_s), -1, np.int16))


def _targets(table: pd.DataFrame) -> Targets:
    ids = table["target_id"].to_numpy(np.int64)
    if len(np.unique(ids)) != len(ids):
        raise DomainError("target ids repeat", field="targets.target_id", accepted="each target once")
    priority = table["priority"].to_numpy(np.float64)
    bad = ~np.isfinite(priority) | (priority < 0)
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        raise DomainError(
            f"target {ids[first]} has no usable reward", field="targets.priority", value=float(priority[first]),
            accepted="finite, >= 0",
        )  # fmt: skip
    kind = table["kind"].astype(str).to_numpy()
    unknown = ~np.isin(kind, ["active", "prefire"])
    if unknown.any():
        raise DomainError(
            "unknown target kind", field="targets.kind", value=str(kind[unknown][0]), accepted="active|prefire"
        )
    active = kind == "active"
    return Targets(ids, active, np.where(active, ACTIVE_WEIGHT, 1.0) * priority)


def _passes(
    contacts: pd.DataFrame, index: dict[str, int], stations: tuple[str, ...], origin: pd.Timestamp, horizon_s: int,
    rules: OperationRules,
) -> list[OpenPass]:  # fmt: skip
    """Whole seconds of each usable contact that may carry data."""
    station = {name: place for place, name in enumerate(stations)}
    return open_passes(
        seconds_from(origin, contacts["start"]), seconds_from(origin, contacts["end"]),
        contacts["satellite"].map(index).to_numpy(np.int64), contacts["station"].map(station).to_numpy(np.int64),
        rules, horizon_s,
    )  # fmt: skip


def _sunlit(eclipses: pd.DataFrame, index: dict[str, int], origin: pd.Timestamp, horizon_s: int) -> BoolArray:
    """(satellites, seconds): true where no part of the second lies in umbra."""
    lit = np.ones((len(index), horizon_s), bool)
    if not len(eclipses):
        return lit
    umbra = eclipses
    if "kind" in eclipses:
        kind = eclipses["kind"].astype("string").fillna("umbra")
        umbra = eclipses[(kind == "umbra").to_numpy()]
    begins, ends = seconds_from(origin, umbra["start"]), seconds_from(origin, umbra["end"])
    for name, begin, end in zip(umbra["satellite"].astype(str), begins, ends, strict=True):
        if name in index and end > begin:
            lit[index[name], max(0, math.floor(begin)) : max(0, math.ceil(end))] = False
    return lit


def _uplinks(
    contacts: pd.DataFrame,
    satellites: tuple[SatelliteLimits, ...],
    origin: pd.Timestamp,
    horizon_s: int,
    release: pd.Timestamp | None,
) -> tuple[IntArray, tuple[pd.Timestamp | None, ...]]:
    """First commandable second of each satellite and the contact that carries the uplink (none without release).

    The commands are on board when the contact is over, so the margin counts from the contact's end.
    """
    if release is None:
        return np.zeros(len(satellites), np.int64), (None,) * len(satellites)
    names = contacts["satellite"].astype(str).to_numpy()
    starts, ends = seconds_from(origin, contacts["start"]), seconds_from(origin, contacts["end"])
    release_s = (release - origin).total_seconds()
    first, used = [], []
    for limits in satellites:
        rows = np.flatnonzero((names == limits.name) & (starts >= release_s))
        if not len(rows):
            first.append(horizon_s)
            used.append(None)
            continue
        row = rows[np.lexsort((ends[rows], starts[rows]))[0]]
        first.append(min(horizon_s, max(0, math.ceil(ends[row] + limits.uplink_margin_s))))
        used.append(pd.Timestamp(contacts["start"].iloc[row]).tz_convert("UTC"))
    return np.array(first, np.int64), tuple(used)


def _images(
    table: pd.DataFrame, index: dict[str, int], targets: Targets, origin: pd.Timestamp, horizon_s: int,
    held: set[str | None],
) -> tuple[Images, IntArray, tuple[str, ...]]:  # fmt: skip
    """Images inside the horizon with their targets, the number of opportunities of every target, and all pointings."""
    order = np.argsort(targets.target_id, kind="stable")
    ids = table["target_id"].to_numpy(np.int64)
    place = np.searchsorted(targets.target_id[order], ids)
    known = place < len(order)
    known[known] = targets.target_id[order][place[known]] == ids[known]
    if not known.all():
        raise DomainError(
            "opportunities name a target that the targets table lacks", field="opportunities.target_id",
            value=int(ids[~known][0]), accepted="ids of the targets table",
        )  # fmt: skip
    second = seconds_from(origin, table["time"])
    if (second != np.floor(second)).any():
        first = int(np.flatnonzero(second != np.floor(second))[0])
        raise DomainError(
            "an image does not start on a whole second from horizon_start", field="opportunities.time",
            value=str(table["time"].iloc[first]), accepted="whole seconds from horizon_start",
        )  # fmt: skip
    pointings, pointing = _pointings(table, held)
    rows = pd.DataFrame({
        "image": table["image_id"].to_numpy(np.int64),
        "satellite": table["satellite"].astype(str).map(index).to_numpy(np.int64),
        "second": second.astype(np.int64), "target": order[place] if len(place) else place, "pointing": pointing,
    }).drop_duplicates(["image", "target"]).sort_values(["satellite", "second", "image", "target"])  # fmt: skip
    place_of = ["satellite", "second", "pointing"]
    heads = rows.drop_duplicates(["image", *place_of])
    if heads["image"].duplicated().any() or heads.duplicated(place_of).any():
        twice = heads[heads["image"].duplicated(keep=False) | heads.duplicated(place_of, keep=False)]
        raise DomainError(
            "an image is not one satellite-second", field="opportunities.image_id", value=int(twice["image"].iloc[0]),
            accepted="one image_id per satellite and time (and pointing, where there are several)",
        )  # fmt: skip
    rows = rows[(rows["second"] >= 0) & (rows["second"] < horizon_s)]
    seen = np.bincount(rows["target"].to_numpy(np.int64), minlength=len(order)).astype(np.int64)
    return _pack(rows), seen, pointings


def _pointings(table: pd.DataFrame, held: set[str | None]) -> tuple[tuple[str, ...], IntArray]:
    """All pointings in order of name, those ``held`` at the start too, and that of every row (none: all alike)."""
    if "pointing" not in table or table["pointing"].isna().all():
        return (), np.zeros(len(table), np.int64)
    if table["pointing"].isna().any():
        row = int(np.flatnonzero(table["pointing"].isna())[0])
        raise DomainError(
            f"row {row} of the opportunities has no pointing while others do", field="opportunities.pointing",
            accepted="a pointing in every row, or in none",
        )  # fmt: skip
    rows = table["pointing"].astype(str)
    names = tuple(sorted({*rows.unique(), *(name for name in held if name is not None)}))
    return names, rows.map({name: place for place, name in enumerate(names)}).to_numpy(np.int64)


def _pack(rows: pd.DataFrame) -> Images:
    heads = rows["image"].ne(rows["image"].shift()).to_numpy()
    starts = np.append(np.flatnonzero(heads), len(rows)).astype(np.int64)
    first = rows[heads]
    columns = (first[name].to_numpy(np.int64) for name in ("image", "satellite", "second"))
    return Images(*columns, starts, rows["target"].to_numpy(np.int64), first["pointing"].to_numpy(np.int64))


def _keep_commandable(problem: PlanningProblem) -> PlanningProblem:
    """Drop images no command can reach: not commandable, or their second taken by the previous plan."""
    images, frozen = problem.images, problem.frozen
    busy = frozen.downlink >= 0
    busy[frozen.satellite, frozen.second] = True
    keep = problem.commandable[images.satellite, images.second] & ~busy[images.satellite, images.second]
    keep[frozen.image[frozen.image >= 0]] = True
    entry = keep[images.image_of_entry()]
    sizes = np.diff(images.start)[keep]
    kept = Images(
        images.image_id[keep], images.satellite[keep], images.second[keep],
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), images.target[entry], images.pointing_of()[keep],
    )  # fmt: skip
    renumber = np.where(keep, np.cumsum(keep) - 1, -1)
    moved = np.where(frozen.image >= 0, renumber[frozen.image], -1)
    return replace(problem, images=kept, frozen=replace(frozen, image=moved.astype(np.int64)))
