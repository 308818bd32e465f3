"""Commands of the previous plan that keep running until a satellite's uplink."""

from __future__ import annotations

import numpy as np
import pandas as pd

from services.planning.problem import Frozen, IntArray, PlanningProblem, SatelliteLimits


def previous_commands(problem: PlanningProblem, previous: pd.DataFrame, first_s: IntArray) -> Frozen:
    """Second-by-second run of the previous schedule up to each satellite's first commandable second.

    Rows that start before ``first_s`` are kept whole. What cannot be executed in the actual state (storage full or
    empty, contact lost, battery at its floor, station taken, satellite unavailable) is dropped and counted: the
    spacecraft would do nothing there, and the new plan must not count on it. Parts before the horizon are history.
    """
    names = {limits.name: row for row, limits in enumerate(problem.satellites)}
    stations = {name: row for row, name in enumerate(problem.stations)}
    visible = np.zeros((len(names), max(1, len(stations)), problem.horizon_s), bool)
    for item in problem.passes:
        visible[item.satellite, item.station, item.start_s : item.end_s] = True
    collect = np.full((len(names), problem.horizon_s), -1, np.int64)
    held = np.full((len(names), problem.horizon_s), -1, np.int64)
    pointings = {name: place for place, name in enumerate(problem.pointings)}
    wanted = np.full((len(names), problem.horizon_s), -1, np.int16)
    origin = problem.horizon_start
    dropped = 0
    for row in previous.itertuples(index=False):
        if str(row.satellite) not in names:
            continue
        satellite = names[str(row.satellite)]
        begin = round((pd.Timestamp(row.start) - origin).total_seconds())
        end = round((pd.Timestamp(row.end) - origin).total_seconds())
        if begin >= first_s[satellite] or end <= 0:
            continue
        begin, end = max(0, begin), min(problem.horizon_s, end)
        if row.command == "collect":
            collect[satellite, begin:end] = int(row.image_id)
            held[satellite, begin:end] = pointings.get(str(getattr(row, "pointing", "")), -1)
        elif str(row.station) in stations:
            wanted[satellite, begin:end] = stations[str(row.station)]
        else:
            dropped += max(0, end - begin)
    return _execute(problem, collect, held, wanted, visible, dropped)


def _execute(
    problem: PlanningProblem, collect: np.ndarray, held: np.ndarray, wanted: np.ndarray, visible: np.ndarray,
    dropped: int,
) -> Frozen:  # fmt: skip
    taken = np.zeros((visible.shape[1], problem.horizon_s), bool)
    available = _available(problem)
    downlink = np.full_like(wanted, -1)
    at = _images_by_place(problem)
    kept: list[tuple[int, int, int, int, int]] = []
    for s, limits in enumerate(problem.satellites):
        stored, progress, battery = limits.stored_images_initial, 0, limits.battery_initial_wh
        last = np.flatnonzero((wanted[s] >= 0) | (collect[s] >= 0)).max(initial=-1)
        for t in range(int(last) + 1):
            g, image = int(wanted[s, t]), int(collect[s, t])
            base = (limits.generation_w if problem.sunlit[s, t] else 0.0) - limits.nominal_w
            if image >= 0:
                ok = available[s, t] and stored < limits.storage_images
                if ok and _powered(battery, base - limits.collect_w, limits):
                    kept.append((s, t, at.get((s, t, int(held[s, t])), -1), image, int(held[s, t])))
                    stored += 1
                    base -= limits.collect_w
                else:
                    dropped += 1
            elif g >= 0:
                ok = available[s, t] and stored > 0 and visible[s, g, t] and not taken[g, t]
                if ok and _powered(battery, base - limits.downlink_w, limits):
                    downlink[s, t] = g
                    taken[g, t] = True
                    progress += 1
                    base -= limits.downlink_w
                    if progress == limits.downlink_s_per_image:
                        stored, progress = stored - 1, 0
                else:
                    dropped += 1
            battery = min(limits.battery_capacity_wh, battery + base / 3600.0)
    return _frozen(problem, kept, downlink, dropped)


def _images_by_place(problem: PlanningProblem) -> dict[tuple[int, int, int], int]:
    """(satellite, second, pointing) -> image; under pointing -1 the only one, where there is no other."""
    own = problem.images
    at: dict[tuple[int, int, int], int] = {}
    for i, (s, t, p) in enumerate(zip(own.satellite, own.second, own.pointing_of(), strict=True)):
        at[(int(s), int(t), int(p))] = i
        if len(problem.pointings) <= 1:
            at[(int(s), int(t), -1)] = i
    return at


def _available(problem: PlanningProblem) -> np.ndarray:
    """Outside ``unavailable`` windows only: the uplink does not bind commands already on board."""
    mask = np.ones_like(problem.commandable)
    for row, limits in enumerate(problem.satellites):
        for begin, end in limits.unavailable:
            last = problem.horizon_s if np.isinf(end) else max(0, int(np.ceil(end)))
            mask[row, max(0, int(np.floor(begin))) : last] = False
    return mask


def _powered(battery: float, net_w: float, limits: SatelliteLimits) -> bool:
    return battery + net_w / 3600.0 >= limits.battery_min_wh


def _frozen(
    problem: PlanningProblem, kept: list[tuple[int, int, int, int, int]], downlink: np.ndarray, dropped: int
) -> Frozen:
    """Give frozen collects ids that cannot be taken for another image of the new opportunities."""
    table = np.array(kept, np.int64).reshape(-1, 5)
    satellite, second, image, old_id, held = table.T
    known = set(problem.images.image_id.tolist())
    spare = int(max(known, default=-1)) + 1
    ids = []
    for index, old in zip(image.tolist(), old_id.tolist(), strict=True):
        if index >= 0:
            ids.append(int(problem.images.image_id[index]))
        elif old in known or old in ids:
            spare = max(spare, int(old_id.max()) + 1)
            ids.append(spare)
            spare += 1
        else:
            ids.append(old)
    pointing = held if problem.pointings else None
    return Frozen(satellite, second, image, np.array(ids, np.int64), downlink, dropped, pointing)
