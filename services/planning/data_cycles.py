"""Data cycles: each satellite's horizon cut where its resources change, so that a cycle holds totals, not seconds.

A *cycle* runs from the end of one pass to the end of the next: collect, then downlink (paper, section 4.1). A *chunk*
is a part of a cycle within which sunlight, visible stations, who else sees them and whether commands are allowed do not
change; all seconds of a chunk are alike, so totals per chunk describe it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.planning.problem import FloatArray, IntArray, PlanningProblem


@dataclass(frozen=True)
class Chunks:
    """Chunks of all satellites, in time order within each; arrays of one entry a chunk unless said.

    ``offset`` (satellites + 1) delimits the satellites. ``base_w`` is generation less nominal draw. ``free_s`` counts
    seconds open to new commands; ``frozen_collect``, ``frozen_downlink`` those the previous plan holds. Links pair a
    chunk with a station it sees; links of several satellites that share a station and a span share a ``cell``, which
    holds ``cell_free_s`` seconds.
    """

    offset: IntArray
    satellite: IntArray
    start_s: IntArray
    end_s: IntArray
    cycle: IntArray
    base_w: FloatArray
    free_s: IntArray
    frozen_collect: IntArray
    frozen_downlink: IntArray
    link_chunk: IntArray
    link_station: IntArray
    link_cell: IntArray
    cell_free_s: IntArray
    image_chunk: IntArray
    """Chunk of every image of the problem."""

    def __len__(self) -> int:
        return len(self.start_s)


def cycle_ends(problem: PlanningProblem, satellite: int) -> IntArray:
    """Seconds at which a satellite's data cycles end: the ends of its passes, overlapping ones taken together."""
    ends: list[int] = []
    for item in (p for p in problem.passes if p.satellite == satellite):
        if ends and item.start_s < ends[-1]:
            ends[-1] = max(ends[-1], item.end_s)
        else:
            ends.append(item.end_s)
    return np.array(ends, np.int64)


def build_chunks(problem: PlanningProblem, extra: tuple[tuple[int, int], ...] = ()) -> Chunks:
    """Chunks of ``problem``; ``extra`` (satellite, second) pairs are cut as well, to sharpen the model there."""
    bounds = _boundaries(problem, extra)
    offset = np.concatenate([[0], np.cumsum([len(b) - 1 for b in bounds])]).astype(np.int64)
    satellite = np.repeat(np.arange(len(bounds)), np.diff(offset))
    start = np.concatenate([b[:-1] for b in bounds] or [np.zeros(0, np.int64)])
    end = np.concatenate([b[1:] for b in bounds] or [np.zeros(0, np.int64)])
    cycle = np.concatenate(
        [np.searchsorted(cycle_ends(problem, s), b[:-1], side="right") for s, b in enumerate(bounds)]
        or [np.zeros(0, np.int64)]
    )
    generation = np.array([limits.generation_w for limits in problem.satellites])[satellite]
    nominal = np.array([limits.nominal_w for limits in problem.satellites])[satellite]
    frozen = problem.frozen
    collected = np.zeros_like(problem.sunlit)
    collected[frozen.satellite, frozen.second] = True
    idle = (frozen.downlink < 0) & ~collected
    free = _sums(problem.commandable & idle, satellite, start, end)
    image_chunk = np.zeros(len(problem.images), np.int64)
    for s, b in enumerate(bounds):
        mine = problem.images.satellite == s
        image_chunk[mine] = offset[s] + np.searchsorted(b, problem.images.second[mine], side="right") - 1
    return Chunks(
        offset, satellite, start, end, cycle,
        np.where(problem.sunlit[satellite, start], generation, 0.0) - nominal,
        free, _sums(collected, satellite, start, end), _sums(frozen.downlink >= 0, satellite, start, end),
        *_links(problem, satellite, start, end, free), image_chunk,
    )  # fmt: skip


def _sums(mask: np.ndarray, satellite: IntArray, start: IntArray, end: IntArray) -> IntArray:
    total = np.zeros((mask.shape[0], mask.shape[1] + 1), np.int64)
    np.cumsum(mask, axis=1, out=total[:, 1:])
    return total[satellite, end] - total[satellite, start]


def _edges(mask: np.ndarray) -> IntArray:
    return np.flatnonzero(mask[1:] != mask[:-1]).astype(np.int64) + 1


def _boundaries(problem: PlanningProblem, extra: tuple[tuple[int, int], ...]) -> list[IntArray]:
    """Cut seconds per satellite, shared between satellites that see one station at the same moment."""
    horizon = problem.horizon_s
    frozen_collect = np.zeros_like(problem.sunlit)
    frozen_collect[problem.frozen.satellite, problem.frozen.second] = True
    cuts: list[set[int]] = []
    for s in range(len(problem.satellites)):
        own = {0, horizon}
        for line in (problem.sunlit[s], problem.commandable[s], problem.frozen.downlink[s], frozen_collect[s]):
            own.update(_edges(line).tolist())
        cuts.append(own)
    for item in problem.passes:
        cuts[item.satellite].update((item.start_s, item.end_s))
    for s, second in extra:
        if 0 < second < horizon:
            cuts[s].add(second)
    _share_cuts(problem, cuts)
    return [np.array(sorted(own), np.int64) for own in cuts]


def _share_cuts(problem: PlanningProblem, cuts: list[set[int]]) -> None:
    """Satellites that share a station get each other's cuts there, so that sharing is about whole chunks."""
    changed = True
    while changed:
        changed = False
        for station in range(len(problem.stations)):
            passes = [p for p in problem.passes if p.station == station]
            shared: set[int] = set()
            for p in passes:
                shared.update(t for t in cuts[p.satellite] if p.start_s <= t <= p.end_s)
            ordered = np.array(sorted(shared), np.int64)
            for p in passes:
                inside = ordered[np.searchsorted(ordered, p.start_s) : np.searchsorted(ordered, p.end_s, "right")]
                before = len(cuts[p.satellite])
                cuts[p.satellite].update(inside.tolist())
                changed |= len(cuts[p.satellite]) > before


def _links(
    problem: PlanningProblem, satellite: IntArray, start: IntArray, end: IntArray, free: IntArray
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Chunk-station pairs open to new downlinks, and the cells in which stations are shared."""
    used = np.zeros((max(1, len(problem.stations)), problem.horizon_s), bool)
    for station in range(len(problem.stations)):
        used[station] = (problem.frozen.downlink == station).any(axis=0)
    chunks, stations, cells, room = [], [], [], []
    cell_of: dict[tuple[int, int, int], int] = {}
    for item in problem.passes:
        mine = (satellite == item.satellite) & (start >= item.start_s) & (end <= item.end_s) & (free > 0)
        for chunk in np.flatnonzero(mine):
            key = (item.station, int(start[chunk]), int(end[chunk]))
            open_s = int((~used[item.station, key[1] : key[2]]).sum())
            if not open_s:
                continue
            cell = cell_of.setdefault(key, len(cell_of))
            if cell == len(room):
                room.append(open_s)
            chunks.append(int(chunk))
            stations.append(item.station)
            cells.append(cell)
    arrays = [np.array(values, np.int64) for values in (chunks, stations, cells, room)]
    return arrays[0], arrays[1], arrays[2], arrays[3]
