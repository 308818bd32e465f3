"""Every rule second by second as one integer program: exact, and small enough for small cases only.

Where the data-cycle model counts totals, this one holds a binary for each satellite-second and pointing, and for each
satellite-second and station, so that recordings, mode switches, slews and command budgets can be written down.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

from services.planning.options.rules import OperationRules
from services.planning.problem import BoolArray, IntArray, PlanningProblem

LARGEST_CELLS = 900
"""Satellite-seconds up to which the program is tried."""
NODES = 20_000


@dataclass(frozen=True)
class ExactSequence:
    """Pointing of every recorded satellite-second (-1: none), station of every downlinked one, and a proven bound."""

    recording: IntArray
    downlink: IntArray
    bound: float
    time_limited: bool


@dataclass
class _Program:
    """Triplets of constraint rows under construction."""

    row: list[int] = field(default_factory=list)
    column: list[int] = field(default_factory=list)
    value: list[float] = field(default_factory=list)
    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)

    def add(self, terms: dict[int, float], low: float, high: float) -> None:
        """One row: low <= sum of coefficient times column <= high."""
        for column, coefficient in terms.items():
            self.row.append(len(self.low))
            self.column.append(column)
            self.value.append(coefficient)
        self.low.append(low)
        self.high.append(high)

    def constraint(self, columns: int) -> LinearConstraint:
        shape = (len(self.low), columns)
        matrix = sparse.csr_array((self.value, (self.row, self.column)), shape=shape)
        return LinearConstraint(matrix, self.low, self.high)


class SecondModel:
    """Columns: recording (s, t, k), downlink (s, t, g), targets, stored image-seconds and charge (s, t), starts."""

    def __init__(self, problem: PlanningProblem, rules: OperationRules, required: BoolArray) -> None:
        self.problem, self.rules = problem, rules
        self.pointings, self.stations = max(1, len(problem.pointings)), max(1, len(problem.stations))
        self.cells = problem.sunlit.shape
        cells = problem.sunlit.size
        sizes = [cells * self.pointings, cells * self.stations, len(problem.targets.value), cells, cells,
                 cells * self.pointings, cells * self.stations]  # fmt: skip
        self.at = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self.program = _Program()
        self.low, self.high = np.zeros(self.at[-1]), np.zeros(self.at[-1])
        self._bounds(required)
        self._coverage()
        for s in range(self.cells[0]):
            self._resources(s)
            self._recordings(s)
            self._switches(s)
            self._slews(s)
            self._budget(s)
        self._stations()

    def record(self, s: int, t: int, k: int) -> int:
        return int((s * self.cells[1] + t) * self.pointings + k)

    def down(self, s: int, t: int, g: int) -> int:
        return int(self.at[1] + (s * self.cells[1] + t) * self.stations + g)

    def _collects(self, s: int, t: int) -> dict[int, float]:
        return {self.record(s, t, k): 1.0 for k in range(self.pointings)}

    def _downs(self, s: int, t: int) -> dict[int, float]:
        return {self.down(s, t, g): 1.0 for g in range(self.stations)}

    def _bounds(self, required: BoolArray) -> None:
        problem, own = self.problem, self.problem.images
        busy = problem.frozen.downlink >= 0
        busy[problem.frozen.satellite, problem.frozen.second] = True
        free = problem.commandable & ~busy
        record = np.zeros((*self.cells, self.pointings))
        if self.rules.min_collect_s > 1:
            record[free] = 1.0
        ok = free[own.satellite, own.second]
        record[own.satellite[ok], own.second[ok], own.pointing_of()[ok]] = 1.0
        self.high[: self.at[1]] = record.ravel()
        down = np.zeros((*self.cells, self.stations))
        for p in problem.passes:
            down[p.satellite, p.start_s : p.end_s, p.station] = free[p.satellite, p.start_s : p.end_s]
        self.high[self.at[1] : self.at[2]] = down.ravel()
        self.high[self.at[2] : self.at[3]] = 1.0
        self.low[self.at[2] : self.at[3]] = required
        per = np.array([x.downlink_s_per_image * x.storage_images for x in problem.satellites], float)
        self.high[self.at[3] : self.at[4]] = np.repeat(per, self.cells[1])
        for name, side in (("battery_min_wh", self.low), ("battery_capacity_wh", self.high)):
            side[self.at[4] : self.at[5]] = np.repeat([getattr(x, name) for x in problem.satellites], self.cells[1])
        self.high[self.at[5] :] = 1.0
        self._fix_frozen()

    def _fix_frozen(self) -> None:
        frozen, own = self.problem.frozen, self.problem.images
        for s, t, image in zip(frozen.satellite, frozen.second, frozen.image, strict=True):
            place = self.record(int(s), int(t), int(own.pointing_of()[image]) if image >= 0 else 0)
            self.low[place] = self.high[place] = 1.0
        for s, t in zip(*np.nonzero(frozen.downlink >= 0), strict=True):
            place = self.down(int(s), int(t), int(frozen.downlink[s, t]))
            self.low[place] = self.high[place] = 1.0

    def _coverage(self) -> None:
        own = self.problem.images
        terms: list[dict[int, float]] = [{} for _ in self.problem.targets.value]
        for image in range(len(own)):
            place = self.record(int(own.satellite[image]), int(own.second[image]), int(own.pointing_of()[image]))
            for target in own.covered(image):
                terms[target][place] = -1.0
        for target, row in enumerate(terms):
            self.program.add({**row, int(self.at[2] + target): 1.0}, -np.inf, 0.0)

    def _resources(self, s: int) -> None:
        """One command a second, storage in image-seconds, charge as it is spent and gained."""
        limits, horizon = self.problem.satellites[s], self.cells[1]
        per = float(limits.downlink_s_per_image)
        for t in range(horizon):
            collects, downs = self._collects(s, t), self._downs(s, t)
            stored, charge = int(self.at[3] + s * horizon + t), int(self.at[4] + s * horizon + t)
            self.program.add(collects | downs, -np.inf, 1.0)
            now = {stored: 1.0} | dict.fromkeys(collects, -per) | dict.fromkeys(downs, 1.0)
            net = (limits.generation_w if self.problem.sunlit[s, t] else 0.0) - limits.nominal_w
            spend = {charge: 1.0} | dict.fromkeys(collects, limits.collect_w / 3600)
            spend |= dict.fromkeys(downs, limits.downlink_w / 3600)
            before = limits.stored_images_initial * per if t == 0 else 0.0
            energy = net / 3600 + (limits.battery_initial_wh if t == 0 else 0.0)
            if t:
                now[stored - 1], spend[charge - 1] = -1.0, -1.0
            self.program.add(now, before, before)
            self.program.add(spend, -np.inf, energy)

    def _recordings(self, s: int) -> None:
        """A recording that starts goes on for its minimum length."""
        need, horizon = self.rules.min_collect_s, self.cells[1]
        old = set(self.problem.frozen.second[self.problem.frozen.satellite == s].tolist())
        for t in range(horizon if need > 1 else 0):
            for k in range(self.pointings):
                begin = {self.record(s, t, k): 1.0}
                if t in old:
                    continue
                if t:
                    begin[self.record(s, t - 1, k)] = -1.0
                if t + need > horizon:
                    self.program.add(begin, -np.inf, 0.0)
                    continue
                for step in range(1, need):
                    self.program.add({**begin, self.record(s, t + step, k): -1.0}, -np.inf, 0.0)

    def _switches(self, s: int) -> None:
        idle, horizon = self.rules.mode_switch_s, self.cells[1]
        busy = self.problem.frozen.downlink[s] >= 0
        busy[self.problem.frozen.second[self.problem.frozen.satellite == s]] = True
        for t in range(horizon):
            for later in range(t + 1, min(horizon, t + idle + 1)):
                if busy[later]:
                    continue
                self.program.add(self._collects(s, t) | self._downs(s, later), -np.inf, 1.0)
                self.program.add(self._downs(s, t) | self._collects(s, later), -np.inf, 1.0)

    def _slews(self, s: int) -> None:
        """Two recordings under different pointings with none between them lie a slew apart."""
        limits, names, horizon = self.problem.satellites[s], self.problem.pointings, self.cells[1]
        if len(names) < 2:
            return
        frozen = set(self.problem.frozen.second[self.problem.frozen.satellite == s].tolist())
        table = limits.slew or {}
        for k, name in enumerate(names):
            first = 0 if limits.pointing_initial in (None, name) else table[str(limits.pointing_initial)][name]
            for t in range(horizon):
                if t in frozen:
                    continue
                if t < first:
                    earlier = {c: -1.0 for u in range(t) for c in self._collects(s, u)}
                    self.program.add({**earlier, self.record(s, t, k): 1.0}, -np.inf, 0.0)
                for j, source in enumerate(names):
                    for u in range(max(0, t - table.get(source, {}).get(name, 0)), t) if j != k else ():
                        between = {c: -1.0 for v in range(u + 1, t) for c in self._collects(s, v)}
                        pair = {self.record(s, u, j): 1.0, self.record(s, t, k): 1.0}
                        self.program.add({**between, **pair}, -np.inf, 1.0)

    def _budget(self, s: int) -> None:
        most, horizon = self.rules.max_commands_per_day, self.cells[1]
        if most is None:
            return
        days: dict[pd.Timestamp, dict[int, float]] = {}
        for t in range(horizon):
            day = (self.problem.horizon_start + pd.Timedelta(seconds=t)).floor("D")
            for width, base, column in ((self.pointings, 5, self.record), (self.stations, 6, self.down)):
                for k in range(width):
                    start = int(self.at[base] + (s * horizon + t) * width + k)
                    row = {start: 1.0, column(s, t, k): -1.0}
                    if t:
                        row[column(s, t - 1, k)] = 1.0
                    self.program.add(row, 0.0, np.inf)
                    days.setdefault(day, {})[start] = 1.0
        old = _frozen_starts(self.problem, s)
        for day, row in days.items():
            self.program.add(row, -np.inf, float(max(most, old.get(day, 0))))

    def _stations(self) -> None:
        for g in range(self.stations):
            for t in range(self.cells[1]):
                self.program.add({self.down(s, t, g): 1.0 for s in range(self.cells[0])}, -np.inf, 1.0)

    def solve(self, time_limit_s: float) -> ExactSequence | None:
        """The best sequence, or None where there is none (or no time)."""
        cost = np.zeros(self.at[-1])
        cost[self.at[2] : self.at[3]] = -self.problem.targets.value
        whole = np.ones(self.at[-1])
        whole[self.at[3] : self.at[5]] = 0
        options = {"time_limit": max(0.1, time_limit_s), "node_limit": NODES, "mip_rel_gap": 1e-9}
        result = milp(cost, integrality=whole, bounds=Bounds(self.low, self.high), options=options,
                      constraints=self.program.constraint(int(self.at[-1])))  # fmt: skip
        if result.x is None:
            return None
        record = result.x[: self.at[1]].reshape(*self.cells, self.pointings) > 0.5
        down = result.x[self.at[1] : self.at[2]].reshape(*self.cells, self.stations) > 0.5
        bound = -float(result.mip_dual_bound) if result.mip_dual_bound is not None else float("inf")
        return ExactSequence(
            np.where(record.any(-1), record.argmax(-1), -1), np.where(down.any(-1), down.argmax(-1), -1),
            bound + 1e-9 * abs(bound), result.status == 1,
        )  # fmt: skip


def _frozen_starts(problem: PlanningProblem, s: int) -> dict[pd.Timestamp, int]:
    """Commands of the previous plan that start on each day, by satellite."""
    horizon = problem.horizon_s
    line = np.full(horizon, -1, np.int64)
    line[problem.frozen.downlink[s] >= 0] = 100 + problem.frozen.downlink[s][problem.frozen.downlink[s] >= 0]
    line[problem.frozen.second[problem.frozen.satellite == s]] = 1
    starts = np.flatnonzero((line >= 0) & (np.concatenate([[-1], line[:-1]]) != line))
    counts: dict[pd.Timestamp, int] = {}
    for t in starts.tolist():
        day = (problem.horizon_start + pd.Timedelta(seconds=t)).floor("D")
        counts[day] = counts.get(day, 0) + 1
    return counts
