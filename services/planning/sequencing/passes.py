"""One unbroken downlink a pass: where recordings, switches and commands count, scattered seconds are of no use."""

from __future__ import annotations

import numpy as np

from services.planning.options.rules import OperationRules
from services.planning.problem import BoolArray, IntArray, Pass, PlanningProblem


def whole_downlinks(
    problem: PlanningProblem, images: IntArray, downlink: np.ndarray, rules: OperationRules, most: int | None,
    stretch: bool,
) -> IntArray:  # fmt: skip
    """(satellites, seconds) station or -1: a block in each pass that ``downlink`` uses, on top of frozen downlinks.

    At most ``most`` blocks a satellite and UTC day, longest first; with ``stretch`` as long as the pass allows, else as
    long as ``downlink``'s total there. Seconds near planned ``images`` are avoided where that leaves enough.
    """
    result = problem.frozen.downlink.astype(np.int64).copy()
    taken = np.zeros((max(1, len(problem.stations)), problem.horizon_s), bool)
    for station in range(len(problem.stations)):
        taken[station] = (result == station).any(axis=0)
    near = _near_images(problem, images, rules)
    old = _near_frozen(problem, rules)
    used: dict[tuple[int, int], int] = {}
    begun = _frozen_commands(problem)
    by_length = sorted(_wanted(problem, downlink), key=lambda item: (-item[1], item[0].start_s, item[0].satellite))
    for p, wanted in by_length:
        day = (p.satellite, _day(problem, p.start_s))
        if most is not None and used.get(day, 0) >= most:
            continue
        budget = rules.max_commands_per_day
        if budget is not None and begun.get(day, 0) + used.get(day, 0) >= budget:
            continue
        span = slice(p.start_s, p.end_s)
        free = problem.commandable[p.satellite, span] & ~old[p.satellite, span] & ~taken[p.station, span]
        free &= result[p.satellite, span] < 0
        begin, end = _longest(free & ~near[p.satellite, span])
        if end - begin < min(wanted, 20):
            begin, end = _longest(free)
        if not stretch:
            end = min(end, begin + wanted)
        if end > begin:
            result[p.satellite, p.start_s + begin : p.start_s + end] = p.station
            taken[p.station, p.start_s + begin : p.start_s + end] = True
            used[day] = used.get(day, 0) + 1
    return result


def _wanted(problem: PlanningProblem, downlink: np.ndarray) -> list[tuple[Pass, int]]:
    """Passes with the downlink seconds that the plan puts there, those with none left out."""
    found = []
    for p in problem.passes:
        line = downlink[p.satellite, p.start_s : p.end_s] == p.station
        line &= problem.frozen.downlink[p.satellite, p.start_s : p.end_s] < 0
        if line.any():
            found.append((p, int(line.sum())))
    return found


def _day(problem: PlanningProblem, second: int) -> int:
    return int((second + problem.horizon_start.timestamp()) // 86_400)


def _frozen_commands(problem: PlanningProblem) -> dict[tuple[int, int], int]:
    """Commands of the previous plan that begin on each day of a satellite."""
    frozen, begun = problem.frozen, dict[tuple[int, int], int]()
    recording = np.full(problem.sunlit.shape, -2)
    recording[frozen.satellite, frozen.second] = 0 if frozen.pointing is None else frozen.pointing
    for line, idle in ((recording, -2), (frozen.downlink.astype(np.int64), -1)):
        earlier = np.concatenate([np.full((len(line), 1), idle), line[:, :-1]], axis=1)
        for s, t in np.argwhere((line != idle) & (line != earlier)).tolist():
            day = (s, _day(problem, t))
            begun[day] = begun.get(day, 0) + 1
    return begun


def _longest(free: BoolArray) -> tuple[int, int]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(np.int8), [0]])))
    if not len(edges):
        return 0, 0
    place = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * place]), int(edges[2 * place + 1])


def _near_images(problem: PlanningProblem, images: IntArray, rules: OperationRules) -> BoolArray:
    """Seconds of planned images, and as long before and after as a mode switch takes."""
    near = np.zeros_like(problem.sunlit)
    near[problem.images.satellite[images], problem.images.second[images]] = True
    return widened(near, rules.mode_switch_s)


def _near_frozen(problem: PlanningProblem, rules: OperationRules) -> BoolArray:
    """Recordings of the previous plan with their mode switches."""
    near = np.zeros_like(problem.sunlit)
    near[problem.frozen.satellite, problem.frozen.second] = True
    return widened(near, rules.mode_switch_s)


def spare_downlinks(problem: PlanningProblem, recording: IntArray, downlink: np.ndarray) -> IntArray:
    """``downlink`` and the station seconds left over, each for a satellite that records nothing then and sees nothing.

    What more is recorded later can then be sent; seconds that stay empty are no command.
    """
    result = downlink.astype(np.int64)
    busy = recording >= 0
    busy[problem.images.satellite, problem.images.second] = True
    taken = np.zeros((max(1, len(problem.stations)), problem.horizon_s), bool)
    for station in range(len(problem.stations)):
        taken[station] = (result == station).any(axis=0)
    for p in problem.passes:
        span = slice(p.start_s, p.end_s)
        free = problem.commandable[p.satellite, span] & ~busy[p.satellite, span] & (result[p.satellite, span] < 0)
        free &= ~taken[p.station, span]
        result[p.satellite, span][free] = p.station
        taken[p.station, span] |= free
    return result


def widened(mask: BoolArray, seconds: int) -> BoolArray:
    """The mask with so many seconds before and after every true one."""
    total = np.zeros((mask.shape[0], mask.shape[1] + 1), np.int64)
    np.cumsum(mask, axis=1, out=total[:, 1:])
    place = np.arange(mask.shape[1])
    low, high = np.maximum(0, place - seconds), np.minimum(mask.shape[1], place + seconds + 1)
    return np.asarray(total[:, high] > total[:, low])
