"""The search's view of a case: flat arrays for the compiled kernels, downlink seconds by link, greedy construction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem
from services.planning.search.kernels import fill, put

REQUIRED_BONUS = 1e6
"""Extra value of a mandatory group inside the search: no pre-fire sum outweighs it."""


@dataclass(frozen=True)
class SearchSpace:
    """Flat arrays for the compiled kernels: images sorted by chunk, limits per satellite, totals per chunk."""

    start: IntArray
    group: IntArray
    value: FloatArray
    chunk: IntArray
    first: IntArray
    """Images of chunk c are ``first[c]:first[c + 1]``."""
    fixed: BoolArray
    chunk_offset: IntArray
    chunk_satellite: IntArray
    chunk_numbers: FloatArray
    """(chunks, 6): length s, base W, free s, foreign frozen collects, frozen downlink s, downlink s allotted."""
    limits: FloatArray
    """(satellites, 8): s per image, storage in image-seconds, stored at start in image-seconds, battery at start, floor
    and capacity in Ws, collect W, downlink W."""

    def objective(self, chosen: BoolArray) -> float:
        """Value of the groups that the chosen images cover, bonuses included."""
        covered = np.zeros(len(self.value), bool)
        covered[self.group[np.repeat(chosen, np.diff(self.start))]] = True
        return float(self.value[covered].sum())

    def meets_required(self, chosen: BoolArray) -> bool:
        """Whether every mandatory group is covered."""
        covered = np.zeros(len(self.value), bool)
        covered[self.group[np.repeat(chosen, np.diff(self.start))]] = True
        return bool(covered[self.value >= REQUIRED_BONUS].all())


def search_space(
    problem: PlanningProblem, chunks: Chunks, coverage: Coverage, downlink_s: IntArray
) -> tuple[SearchSpace, IntArray]:
    """The space of ``coverage``'s images under an allotment of downlink seconds per chunk.

    Also returns the order: position in the space -> position in ``coverage``.
    """
    chunk_of = chunks.image_chunk[coverage.image]
    order = np.argsort(chunk_of, kind="stable")
    matrix = coverage.matrix()[order]
    foreign = chunks.frozen_collect - np.bincount(chunks.image_chunk[problem.frozen_images], minlength=len(chunks))
    numbers = np.column_stack([
        chunks.end_s - chunks.start_s, chunks.base_w, chunks.free_s, foreign, chunks.frozen_downlink, downlink_s,
    ]).astype(float)  # fmt: skip
    limits = np.array([
        [x.downlink_s_per_image, x.downlink_s_per_image * x.storage_images,
         x.downlink_s_per_image * x.stored_images_initial, 3600 * x.battery_initial_wh, 3600 * x.battery_min_wh,
         3600 * x.battery_capacity_wh, x.collect_w, x.downlink_w] for x in problem.satellites
    ], float).reshape(-1, 8)  # fmt: skip
    space = SearchSpace(
        matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64),
        coverage.value + REQUIRED_BONUS * coverage.required, chunk_of[order],
        np.searchsorted(chunk_of[order], np.arange(len(chunks) + 1)).astype(np.int64),
        np.isin(coverage.image[order], problem.frozen_images), chunks.offset, chunks.satellite, numbers, limits,
    )  # fmt: skip
    return space, order


def construct(
    space: SearchSpace,
    ranking: IntArray,
    minimum: float = 0.0,
    seed: BoolArray | None = None,
    quota: IntArray | None = None,
) -> BoolArray:
    """Images taken greedily in ``ranking`` order, on top of the fixed ones and ``seed``, as resources allow.

    With ``quota`` (images per chunk) the best ranked of every chunk up to its quota come before all others.
    """
    chosen = np.zeros(len(space.chunk), bool)
    cover, count = np.zeros(len(space.value), np.int64), np.zeros(len(space.chunk_satellite), np.int64)
    for i in np.flatnonzero(space.fixed):
        put(i, 1, space.start, space.group, space.chunk, cover, count)
        chosen[i] = True
    if seed is not None:
        fill(np.flatnonzero(seed), minimum, chosen, cover, count, *_statics(space))
    if quota is not None:
        by_chunk = ranking[np.argsort(space.chunk[ranking], kind="stable")]
        within = np.arange(len(by_chunk)) - space.first[space.chunk[by_chunk]]
        head = np.zeros(len(ranking), bool)
        head[by_chunk] = within < quota[space.chunk[by_chunk]]
        fill(ranking[head[ranking]].astype(np.int64), minimum, chosen, cover, count, *_statics(space))
    fill(ranking.astype(np.int64), minimum, chosen, cover, count, *_statics(space))
    return chosen


def _statics(space: SearchSpace) -> tuple[np.ndarray, ...]:
    return (
        space.start, space.group, space.value, space.chunk, space.chunk_satellite, space.chunk_offset,
        space.chunk_numbers, space.limits,
    )  # fmt: skip


@dataclass(frozen=True)
class Allotment:
    """Whole downlink seconds of every link, and what bounds them: most per link, room per chunk, spare per cell.

    ``cell_start`` and ``cell_link`` list the links of the cells among which seconds may move.
    """

    link_s: IntArray
    link_chunk: IntArray
    link_most: IntArray
    room: IntArray
    spare: IntArray
    cell_start: IntArray
    cell_link: IntArray

    def per_chunk(self) -> IntArray:
        """Seconds of every chunk."""
        return np.bincount(self.link_chunk, self.link_s, minlength=len(self.room)).astype(np.int64)


def allot_downlinks(chunks: Chunks, links: np.ndarray, spare: bool) -> Allotment:
    """Whole downlink seconds from a plan's ``links`` (seconds, not necessarily whole).

    Rounded so that no station is shared beyond its seconds; with ``spare`` the station time left over is handed out
    too (largest fraction first), else only what was asked for, since downlinking costs energy, and the rest stays
    open to the search.
    """
    most = np.minimum(chunks.free_s[chunks.link_chunk], chunks.cell_free_s[chunks.link_cell])
    given = np.minimum(np.floor(links + 1e-6), most).astype(np.int64)
    left = chunks.cell_free_s - np.bincount(chunks.link_cell, given, minlength=len(chunks.cell_free_s)).astype(np.int64)
    room = chunks.free_s - np.bincount(chunks.link_chunk, given, minlength=len(chunks)).astype(np.int64)
    for link in np.lexsort((-(links - given), chunks.link_cell)):
        cell, chunk = chunks.link_cell[link], chunks.link_chunk[link]
        limit = most[link] if spare else np.ceil(links[link] - 1e-6)
        more = max(0, min(left[cell], room[chunk], int(limit) - given[link]))
        given[link] += more
        left[cell] -= more
        room[chunk] -= more
    sharing = np.bincount(chunks.link_cell, minlength=len(left))
    movable = np.flatnonzero((sharing > 1) | (sharing * left > 0))
    links_of = [np.flatnonzero(chunks.link_cell == cell) for cell in movable]
    return Allotment(
        given, chunks.link_chunk, most, room, left[movable],
        np.concatenate([[0], np.cumsum([len(x) for x in links_of])]).astype(np.int64),
        np.concatenate([np.zeros(0, np.int64), *links_of]).astype(np.int64),
    )  # fmt: skip


def energy_binds(problem: PlanningProblem, chunks: Chunks) -> bool:
    """Whether downlinking in every contact second and collecting every image could reach a battery floor."""
    collect = np.bincount(chunks.image_chunk, minlength=len(chunks))
    downlink = np.bincount(chunks.link_chunk, chunks.free_s[chunks.link_chunk], minlength=len(chunks))
    for s, limits in enumerate(problem.satellites):
        charge = limits.battery_initial_wh
        for c in range(chunks.offset[s], chunks.offset[s + 1]):
            spent = (collect[c] + chunks.frozen_collect[c]) * limits.collect_w
            spent += (downlink[c] + chunks.frozen_downlink[c]) * limits.downlink_w
            if charge - spent / 3600 < limits.battery_min_wh:
                return True
            gain = chunks.base_w[c] * (chunks.end_s[c] - chunks.start_s[c]) / 3600
            charge = min(limits.battery_capacity_wh, charge + gain) - spent / 3600
            if charge < limits.battery_min_wh:
                return True
    return False
