"""Which recordings to make where they have a shortest length: an integer program over windows, with a proven bound.

Every plan of recordings is a choice of windows (`windows.py`) that obeys the totals of each data cycle, so the
program's optimum bounds all plans of recordings. It is small because only dear targets have a row of their own, and
tight because half a recording, which the relaxation by images takes gladly, is no window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks, build_chunks
from services.planning.milp import DataCycleModel, build_model
from services.planning.problem import BoolArray, FloatArray, Images, IntArray, PlanningProblem
from services.planning.search.space import energy_binds
from services.planning.sequencing.windows import Windows, recording_windows
from services.planning.solving import branch_and_bound, solve_relaxation

DEAR = 5.0
"""What makes a target dear: so many times the mean value, if it is neither active nor pinned."""
NODES, COUNT_NODES = 1, 1
ROUNDS = 4
"""Times that prices are settled."""
ROUGHLY, CLOSELY = 5_000, 12_000
"""Windows to compare with each other while prices are settled, and at last."""
COUNT_SHARE, VALUE_SHARE = 0.3, 0.7
"""Shares of the time left that guard the two programs."""


@dataclass(frozen=True)
class ChosenRecordings:
    """``recording``: (satellites, seconds) pointing or -1, None where none was found; ``bound`` on equation 1 of any
    plan of recordings, with ``all_demanded`` of those alone that meet every demanded target.

    ``possible``: whether all demanded targets can be met together (None: not decided); ``most``: no more can.
    """

    recording: IntArray | None
    bound: float
    all_demanded: bool
    possible: bool | None
    most: int
    time_limited: bool


class RecordingProgram:
    """Columns: windows, dear targets, then downlinks, storage and charge of every chunk as in `milp`."""

    def __init__(self, problem: PlanningProblem, least: int) -> None:
        self.problem, self.chunks, self.least = problem, build_chunks(problem), least
        value = problem.targets.value
        mean = float(value.sum()) / max(1, len(value))
        self.held = problem.covered_targets(problem.frozen_images)
        wanted = problem.targets.active | problem.targets.demanded() | (value > DEAR * mean)
        reachable = problem.covered_targets(np.arange(len(problem.images))) & ~self.held
        self.dear = np.flatnonzero(wanted & reachable)
        self.plain = reachable & ~wanted
        self.price = np.where(self.plain, value, 0.0)
        self.energy = energy_binds(problem, self.chunks)
        self.windows = self._windows(ROUGHLY)

    def _windows(self, most: int) -> Windows | None:
        return recording_windows(self.problem, self.chunks, self.least, self.dear, self.price, self.energy, most)

    def settle_prices(self, left: Callable[[], float]) -> bool:
        """Lower the price of targets that the relaxation counts more than once, then look closely at all windows.

        A plain target counts at its ``price`` in every window, and at what its value exceeds that once for all, which
        bounds what it brings, whatever the price (Lagrangian relaxation). Returns whether time cut that short.
        """
        value, mean = self.problem.targets.value, np.zeros(len(self.price))
        for done in range(ROUNDS):
            if self.windows is None or not self.plain.any():
                return False
            model = self._model(self.windows.worth, value[self.dear], np.zeros(len(self.dear), bool))
            relaxed = solve_relaxation(model, left() * COUNT_SHARE)
            if relaxed.dual is None:
                return relaxed.time_limited
            mean += (self._cover(relaxed.images) - mean) / (done + 1)
            self.price = np.where(self.plain, value / np.maximum(1.0, mean), 0.0)
            self.windows = self._windows(CLOSELY if done == ROUNDS - 1 else ROUGHLY)
        return False

    def _cover(self, share: FloatArray) -> FloatArray:
        """How often every target is held by windows of which there are so many."""
        own, windows, cover = self.problem.images, self.windows, np.zeros(len(self.price))
        assert windows is not None
        for i in np.flatnonzero(share > 1e-3):
            mine = (own.satellite == windows.satellite[i]) & (own.pointing_of() == windows.pointing[i])
            mine &= (own.second >= windows.second[i]) & (own.second < windows.second[i] + windows.length[i])
            seen = [own.covered(image) for image in np.flatnonzero(mine)]
            cover[np.unique(np.concatenate(seen))] += share[i]
        return cover

    def solve(
        self, required: BoolArray, pinned: BoolArray, gap: float, left: Callable[[], float]
    ) -> ChosenRecordings | None:
        """The best recordings with all ``required`` targets if these can be met, else with those ``pinned``.

        ``required`` and ``pinned`` are masks over all targets, ``gap`` is relative, ``left`` the guard in seconds. None
        where there are no windows, or too many.
        """
        if self.windows is None:
            return None
        demanded, value = required[self.dear], self.problem.targets.value
        met, most, cut = self._count(demanded, left) if demanded.any() else (0, 0, False)
        possible = True if met == demanded.sum() else (False if most < demanded.sum() else None)
        cut |= self.settle_prices(left)
        if self.windows is None:
            return ChosenRecordings(None, float("inf"), False, possible, most, cut)
        constant = float(value[self.held].sum() + (value - self.price)[self.plain].sum())
        least = pinned[self.dear]
        for demand in (demanded, least) if possible else (least,):
            model = self._model(self.windows.worth, value[self.dear], demand)
            found = branch_and_bound(model, self._whole(model), gap, NODES, left() * VALUE_SHARE)
            cut |= found.time_limited
            if found.feasible:
                more = bool((demand & ~least).any())
                bound = found.bound + constant
                return ChosenRecordings(self._recording(found.images), bound, more, possible, most, cut)
        return ChosenRecordings(None, float("inf"), False, possible, most, cut)

    def _count(self, demanded: BoolArray, left: Callable[[], float]) -> tuple[int, int, bool]:
        """How many of the demanded dear targets are met together, how many can be at most, whether time cut that."""
        assert self.windows is not None
        model = self._model(np.zeros(len(self.windows)), demanded.astype(float), np.zeros(len(demanded), bool))
        found = branch_and_bound(model, self._whole(model), 1e-6, COUNT_NODES, left() * COUNT_SHARE)
        met = int(((self.windows.dear.T @ (found.images > 0.5)) > 0)[demanded].sum())
        most = max(met, min(int(demanded.sum()), int(found.bound + 1e-3)))
        return met, most, found.time_limited and met < most

    def _model(self, worth: FloatArray, value: FloatArray, demanded: BoolArray) -> DataCycleModel:
        windows, count = self.windows, len(self.dear)
        assert windows is not None
        base, chunks = _resources(self.problem, self.chunks), len(self.chunks)
        stored, powered = self._seconds()
        battery = len(base.row_low) - chunks
        rows, rest = base.matrix[:, :chunks], base.matrix[:, chunks:]
        used = sparse.vstack([rows[:battery] @ stored, rows[battery:] @ powered])
        matrix = sparse.csr_array(sparse.block_array([
            [used, None, rest], [-windows.dear.T, sparse.eye_array(count), None],
        ]))  # fmt: skip
        matrix.eliminate_zeros()
        matrix.sort_indices()
        others = np.zeros(rest.shape[1])
        return DataCycleModel(
            np.concatenate([worth, value, others]), matrix,
            np.concatenate([base.row_low, np.full(count, -np.inf)]), np.concatenate([base.row_high, np.zeros(count)]),
            np.concatenate([np.zeros(len(windows)), demanded, base.low[chunks:]]),
            np.concatenate([windows.times, np.ones(count), base.high[chunks:]]), len(windows), count, base.links,
        )  # fmt: skip

    def _seconds(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """(chunks, windows): seconds for which a window fills storage in a chunk, and those for which it draws power.

        A window over several chunks without downlinks might as well fill storage in the last. Its draw is left out:
        what it takes from a full battery in sunlight costs nothing.
        """
        windows, chunks = self.windows, self.chunks
        assert windows is not None
        row, column, seconds, power = [], [], [], []
        for i in range(len(windows)):
            begin, end = int(windows.second[i]), int(windows.second[i] + windows.length[i])
            c = int(windows.chunk[i])
            if not windows.spread[i]:
                parts = [(c, end - begin)]
            else:
                parts = []
                while c >= 0 and chunks.satellite[c] == windows.satellite[i] and chunks.end_s[c] > begin:
                    parts.append((c, int(min(end, chunks.end_s[c]) - max(begin, chunks.start_s[c]))))
                    c -= 1
            row += [c for c, _ in parts]
            seconds += [float(n) for _, n in parts]
            power += [float(n) * bool(windows.inside[i] or windows.spread[i]) for _, n in parts]
            column += [i] * len(parts)
        shape = (len(chunks), len(windows))
        stored = sparse.csr_array((seconds, (row, column)), shape=shape)
        return stored, sparse.csr_array((power, (row, column)), shape=shape)

    def _whole(self, model: DataCycleModel) -> BoolArray:
        whole = np.zeros(len(model.cost), bool)
        whole[: model.images] = True
        return whole

    def _recording(self, share: FloatArray) -> IntArray:
        """The chosen windows second by second; of windows that overlap under two pointings the first stands."""
        windows = self.windows
        assert windows is not None
        result = np.full(self.problem.sunlit.shape, -1, np.int64)
        for i in np.flatnonzero(share > 0.5):
            line = result[windows.satellite[i], windows.second[i] : windows.second[i] + windows.length[i]]
            if ((line < 0) | (line == windows.pointing[i])).all():
                line[:] = windows.pointing[i]
        for i in np.flatnonzero(share > 1.5):
            for _ in range(round(float(share[i])) - 1):
                self._place_again(result, int(i))
        return result

    def _place_again(self, recording: IntArray, window: int) -> None:
        """Where a window is chosen several times: another of its chunk, where most is left to see, if one is free."""
        windows, chunks, own, value = self.windows, self.chunks, self.problem.images, self.problem.targets.value
        assert windows is not None
        s, c, length = windows.satellite[window], windows.chunk[window], int(windows.length[window])
        begin, end = int(chunks.start_s[c]), int(chunks.end_s[c])
        taken = np.flatnonzero(recording[own.satellite, own.second] == own.pointing_of())
        worth = np.where(self.held | self.problem.covered_targets(taken), 0.0, value)
        there = np.flatnonzero((own.satellite == s) & (own.second >= begin) & (own.second < end))
        gain = np.zeros((max(1, len(self.problem.pointings)), end - begin + 1))
        for i in there:
            gain[own.pointing_of()[i], own.second[i] - begin + 1] = worth[own.covered(i)].sum()
        frozen = self.problem.frozen
        free = (
            self.problem.commandable[s, begin:end] & (recording[s, begin:end] < 0) & (frozen.downlink[s, begin:end] < 0)
        )
        free[frozen.second[(frozen.satellite == s) & (frozen.second >= begin) & (frozen.second < end)] - begin] = False
        open_s = np.concatenate([[0], np.cumsum(free)])
        fits = open_s[length:] - open_s[:-length] == length
        total = np.cumsum(gain, axis=1)
        sums = np.where(fits, total[:, length:] - total[:, :-length], 0.0)
        if sums.size and sums.max() > 0:
            pointing, first = np.unravel_index(int(sums.argmax()), sums.shape)
            recording[s, begin + first : begin + first + length] = pointing


def _resources(problem: PlanningProblem, chunks: Chunks) -> DataCycleModel:
    """Storage, time, station and battery rows over the number of seconds recorded in each chunk (its first columns)."""
    every = np.arange(len(chunks))
    none = np.zeros(len(chunks) + 1, np.int64)
    images = Images(every, chunks.satellite, chunks.start_s, none, none[:0])
    frozen = replace(problem.frozen, image=np.full(len(problem.frozen.image), -1))
    coverage = Coverage(every, none, none[:0], np.zeros(0), np.zeros(0, bool), none[:0])
    return build_model(
        replace(problem, images=images, frozen=frozen), replace(chunks, image_chunk=every), coverage
    )  # fmt: skip
