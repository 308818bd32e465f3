"""From contract tables to a `PlanningProblem`: validation, whole-second rounding, release and previous plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from services.planning.frozen import previous_commands
from services.planning.problem import (
    ACTIVE_WEIGHT,
    BoolArray,
    Frozen,
    Images,
    IntArray,
    Pass,
    PlanningProblem,
    SatelliteLimits,
    Targets,
)
from shared.errors import DomainError


def seconds_from(start: pd.Timestamp, times: pd.Series) -> np.ndarray:
    """Seconds (float, exact to the microsecond) from ``start`` to each time."""
    stamps = pd.to_datetime(times, utc=True).dt.as_unit("us").to_numpy("datetime64[us]")
    if np.isnat(stamps).any():
        raise DomainError(f"column '{times.name}' holds a missing time", field=str(times.name), accepted="UTC times")
    origin = start.tz_convert("UTC").tz_localize(None).to_datetime64().astype("datetime64[us]")
    return np.asarray((stamps - origin).astype("int64") / 1e6)


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
) -> PlanningProblem:
    """Validate the inputs and cut them to whole seconds of the horizon.

    ``spacecraft`` maps every satellite name of the tables to its limits. With ``release`` a satellite accepts new
    commands from the end of its first contact that starts at or after release, plus its uplink margin; until then the
    rows of ``previous`` run on. Raises `DomainError` naming the offending field.
    """
    if horizon_s <= 0:
        raise DomainError("the horizon is empty", field="spacecraft.horizon_s", value=horizon_s, accepted="> 0 seconds")
    names = tuple(sorted(set(opportunities["satellite"].astype(str)) | set(contacts["satellite"].astype(str))))
    satellites = tuple(_checked_limits(spacecraft[name]) for name in names)
    stations = tuple(sorted(set(contacts["station"].astype(str))))
    index = {name: position for position, name in enumerate(names)}
    goals = _targets(targets)
    passes = _passes(contacts, index, stations, horizon_start, horizon_s)
    sunlit = _sunlit(eclipses, index, horizon_start, horizon_s)
    first_s, uplinks = _uplinks(contacts, satellites, horizon_start, horizon_s, release)
    commandable = np.arange(horizon_s)[None, :] >= first_s[:, None]
    for row, limits in enumerate(satellites):
        for begin, end in limits.unavailable:
            commandable[row, max(0, math.floor(begin)) : max(0, math.ceil(end))] = False
    images, seen = _images(opportunities, index, goals, horizon_start, horizon_s)
    problem = PlanningProblem(
        horizon_start, horizon_s, satellites, stations, passes, sunlit, commandable, images, goals,
        _no_frozen(len(names), horizon_s), uplinks, seen,
    )  # fmt: skip
    if release is not None and previous is not None and len(previous):
        problem = replace(problem, frozen=previous_commands(problem, previous, first_s))
    return _keep_commandable(problem)


def _no_frozen(satellites: int, horizon_s: int) -> Frozen:
    empty = np.zeros(0, np.int64)
    return Frozen(empty, empty, empty, empty, np.full((satellites, horizon_s), -1, np.int16))


def _checked_limits(limits: SatelliteLimits) -> SatelliteLimits:
    name = limits.name
    if limits.battery_initial_wh < limits.battery_min_wh:
        raise DomainError(
            f"the battery of {name} starts below its floor", field="spacecraft.battery_initial_wh",
            value=limits.battery_initial_wh, accepted=f">= battery_min_wh ({limits.battery_min_wh:g} Wh)",
        )  # fmt: skip
    if limits.battery_initial_wh > limits.battery_capacity_wh:
        raise DomainError(
            f"the battery of {name} starts above its capacity", field="spacecraft.battery_initial_wh",
            value=limits.battery_initial_wh, accepted=f"<= battery_capacity_wh ({limits.battery_capacity_wh:g} Wh)",
        )  # fmt: skip
    if not 0 <= limits.stored_images_initial <= limits.storage_images:
        raise DomainError(
            f"{name} starts with more images than it can store", field="spacecraft.stored_images_initial",
            value=limits.stored_images_initial, accepted=f"0..{limits.storage_images}",
        )  # fmt: skip
    return limits


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
    contacts: pd.DataFrame, index: dict[str, int], stations: tuple[str, ...], origin: pd.Timestamp, horizon_s: int
) -> tuple[Pass, ...]:
    """Whole seconds inside each contact; overlapping contacts of one satellite with one station are refused."""
    frame = pd.DataFrame({
        "satellite": contacts["satellite"].astype(str).map(index).to_numpy(),
        "station": contacts["station"].astype(str).map({name: i for i, name in enumerate(stations)}).to_numpy(),
        "start": seconds_from(origin, contacts["start"]),
        "end": seconds_from(origin, contacts["end"]),
    }).sort_values(["satellite", "station", "start", "end"])  # fmt: skip
    if (frame["end"] < frame["start"]).any():
        raise DomainError("a contact ends before it starts", field="contacts.end", accepted="end >= start")
    same = frame.duplicated(["satellite", "station"])
    overlap = same & (frame["start"] < frame["end"].shift())
    if overlap.any():
        row = frame[overlap].iloc[0]
        name = list(index)[int(row["satellite"])]
        start = origin + pd.Timedelta(seconds=float(row["start"]))
        raise DomainError(
            f"contacts of {name} with {stations[int(row['station'])]} overlap", field="contacts.start",
            value=start.isoformat(), accepted="one contact of a satellite with a station at a time",
        )  # fmt: skip
    passes = []
    for row in frame.itertuples(index=False):
        begin, end = max(0, math.ceil(row.start)), min(horizon_s, math.floor(row.end))
        if end > begin:
            passes.append(Pass(int(row.satellite), int(row.station), begin, end))
    return tuple(sorted(passes, key=lambda p: (p.satellite, p.start_s, p.station)))


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
    table: pd.DataFrame, index: dict[str, int], targets: Targets, origin: pd.Timestamp, horizon_s: int
) -> tuple[Images, IntArray]:
    """Images inside the horizon with their targets, and the number of opportunities of every target."""
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
    rows = pd.DataFrame({
        "image": table["image_id"].to_numpy(np.int64),
        "satellite": table["satellite"].astype(str).map(index).to_numpy(np.int64),
        "second": second.astype(np.int64), "target": order[place] if len(place) else place,
    }).drop_duplicates(["image", "target"]).sort_values(["satellite", "second", "image", "target"])  # fmt: skip
    heads = rows.drop_duplicates(["image", "satellite", "second"])
    if heads["image"].duplicated().any() or heads.duplicated(["satellite", "second"]).any():
        twice = heads[heads["image"].duplicated(keep=False) | heads.duplicated(["satellite", "second"], keep=False)]
        raise DomainError(
            "an image is not one satellite-second", field="opportunities.image_id", value=int(twice["image"].iloc[0]),
            accepted="one image_id per satellite and time",
        )  # fmt: skip
    rows = rows[(rows["second"] >= 0) & (rows["second"] < horizon_s)]
    seen = np.bincount(rows["target"].to_numpy(np.int64), minlength=len(order)).astype(np.int64)
    return _pack(rows), seen


def _pack(rows: pd.DataFrame) -> Images:
    heads = rows["image"].ne(rows["image"].shift()).to_numpy()
    starts = np.append(np.flatnonzero(heads), len(rows)).astype(np.int64)
    first = rows[heads]
    columns = (first[name].to_numpy(np.int64) for name in ("image", "satellite", "second"))
    return Images(*columns, starts, rows["target"].to_numpy(np.int64))


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
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), images.target[entry],
    )  # fmt: skip
    renumber = np.where(keep, np.cumsum(keep) - 1, -1)
    moved = np.where(frozen.image >= 0, renumber[frozen.image], -1)
    return replace(problem, images=kept, frozen=replace(frozen, image=moved.astype(np.int64)))
