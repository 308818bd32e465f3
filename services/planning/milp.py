"""The data-cycle MILP (paper, equations 1-3 and constraints 1-4) as arrays, and bounds proven by weak duality."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.problem import FloatArray, IntArray, PlanningProblem

BOUND_MARGIN = 1e-9
"""Relative margin added to computed bounds against rounding in the last digits."""


@dataclass(frozen=True)
class DataCycleModel:
    """maximise cost.v, row_low <= matrix v <= row_high, low <= v <= high; v = (w images, x groups, d links, u, b).

    w: image collected; x: target group observed; d: downlink seconds per link; u: stored image-seconds
    (downlink_s_per_image times images, less downlink progress) and b: battery in Wh, both after each chunk.
    """

    cost: FloatArray
    matrix: sparse.csr_array
    row_low: FloatArray
    row_high: FloatArray
    low: FloatArray
    high: FloatArray
    images: int
    groups: int
    links: int
    cuts: int = 0
    """Rows right after those of coverage that every set of whole images satisfies (`with_cuts`)."""

    @property
    def priced(self) -> int:
        """Rows that speak of images and groups only: coverage and cuts."""
        return self.groups + self.cuts


def with_cuts(model: DataCycleModel, rows: sparse.csr_array, high: FloatArray) -> DataCycleModel:
    """The model with further rows, ``rows`` v <= ``high``, in place of the cuts it has."""
    matrix = sparse.csr_array(sparse.vstack([model.matrix[: model.groups], rows, model.matrix[model.priced :]]))
    matrix.sort_indices()
    none = np.full(len(high), -np.inf)
    return replace(
        model, matrix=matrix, cuts=len(high),
        row_low=np.concatenate([model.row_low[: model.groups], none, model.row_low[model.priced :]]),
        row_high=np.concatenate([model.row_high[: model.groups], high, model.row_high[model.priced :]]),
    )  # fmt: skip


def build_model(problem: PlanningProblem, chunks: Chunks, coverage: Coverage) -> DataCycleModel:
    """The model over ``coverage``'s images. Every second-exact plan satisfies it, so its optimum bounds all plans.

    Storage is written in image-seconds u = s * (images in store) - progress: with whole images, u <= s * capacity says
    that storage never overflows and u >= 0 that nothing is downlinked from empty storage, without any rounding.
    """
    n, m, k, c = len(coverage.image), len(coverage.value), len(chunks.link_chunk), len(chunks)
    at = np.cumsum([0, n, m, k, c, c])
    chunk_of = chunks.image_chunk[coverage.image]
    per_image = np.array([x.downlink_s_per_image for x in problem.satellites], float)[chunks.satellite]
    rows = _Rows(int(at[5]))
    _coverage_rows(rows, coverage, n)
    _storage_rows(rows, problem, chunks, chunk_of, at, per_image)
    _time_rows(rows, chunks, chunk_of, at)
    _battery_rows(rows, problem, chunks, chunk_of, at)
    low, high = np.zeros(at[5]), np.ones(at[5])
    low[at[0] : at[1]] = np.isin(coverage.image, problem.frozen_images)
    low[at[1] : at[2]] = coverage.required
    high[at[2] : at[3]] = np.minimum(chunks.free_s[chunks.link_chunk], chunks.cell_free_s[chunks.link_cell])
    high[at[3] : at[4]] = per_image * np.array([x.storage_images for x in problem.satellites])[chunks.satellite]
    low[at[4] :] = np.array([x.battery_min_wh for x in problem.satellites])[chunks.satellite]
    high[at[4] :] = np.array([x.battery_capacity_wh for x in problem.satellites])[chunks.satellite]
    cost = np.zeros(at[5])
    cost[at[1] : at[2]] = coverage.value
    return DataCycleModel(cost, rows.matrix(), *rows.bounds(), low, high, n, m, k)


class _Rows:
    """Collects constraint rows as triplets."""

    def __init__(self, columns: int) -> None:
        self.columns, self.count = columns, 0
        self.parts: list[tuple[IntArray, IntArray, FloatArray]] = []
        self.low: list[FloatArray] = []
        self.high: list[FloatArray] = []

    def add(self, low: FloatArray, high: FloatArray, *terms: tuple[IntArray, IntArray, FloatArray]) -> None:
        """New rows with bounds; each term is (row within the new rows, column, coefficient)."""
        for row, column, coefficient in terms:
            self.parts.append((row + self.count, column, np.broadcast_to(coefficient, row.shape).astype(float)))
        self.low.append(low)
        self.high.append(high)
        self.count += len(low)

    def matrix(self) -> sparse.csr_array:
        row, column, value = (np.concatenate([part[i] for part in self.parts]) for i in range(3))
        matrix = sparse.csr_array((value, (row, column)), shape=(self.count, self.columns))
        matrix.sort_indices()
        return matrix

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        return np.concatenate(self.low), np.concatenate(self.high)


def _coverage_rows(rows: _Rows, coverage: Coverage, n: int) -> None:
    """Equation 2: a group counts only if an image that sees it is collected."""
    groups = np.arange(len(coverage.value))
    entries = np.repeat(np.arange(len(coverage.image)), np.diff(coverage.start))
    none = np.full(len(groups), -np.inf)
    rows.add(none, np.zeros(len(groups)), (groups, n + groups, 1.0), (coverage.group, entries, -1.0))


def _storage_rows(
    rows: _Rows, problem: PlanningProblem, chunks: Chunks, chunk_of: IntArray, at: IntArray, per_image: FloatArray
) -> None:
    every = np.arange(len(chunks))
    later = every[~np.isin(every, chunks.offset[:-1])]
    constant = per_image * chunks.frozen_collect - chunks.frozen_downlink
    stored = np.array([x.stored_images_initial * x.downlink_s_per_image for x in problem.satellites], float)
    constant[chunks.offset[:-1]] += stored
    images = np.arange(len(chunk_of))
    # a frozen image known to the opportunities is a w fixed to 1: count it there, not in the constant
    known = problem.frozen_images
    np.subtract.at(constant, chunks.image_chunk[known], per_image[chunks.image_chunk[known]])
    rows.add(
        constant, constant, (every, at[3] + every, 1.0), (later, at[3] + later - 1, -1.0),
        (chunk_of, images, -per_image[chunk_of]),
        (chunks.link_chunk, at[2] + np.arange(len(chunks.link_chunk)), 1.0),
    )  # fmt: skip


def _time_rows(rows: _Rows, chunks: Chunks, chunk_of: IntArray, at: IntArray) -> None:
    """A second is spent collecting or downlinking, and a station serves one satellite at a time."""
    links = np.arange(len(chunks.link_chunk))
    frozen = chunks.frozen_collect[chunks.link_chunk]
    mixed = np.unique(chunks.link_chunk[frozen == 0])
    counts = np.bincount(chunks.link_chunk, minlength=len(chunks))
    images_in = np.bincount(chunk_of, minlength=len(chunks))
    mixed = mixed[(images_in[mixed] > 0) | (counts[mixed] > 1)]
    place = np.full(len(chunks), -1, np.int64)
    place[mixed] = np.arange(len(mixed))
    image, link = np.flatnonzero(place[chunk_of] >= 0), links[place[chunks.link_chunk] >= 0]
    rows.add(
        np.full(len(mixed), -np.inf), chunks.free_s[mixed].astype(float),
        (place[chunk_of[image]], image, 1.0), (place[chunks.link_chunk[link]], at[2] + link, 1.0),
    )  # fmt: skip
    shared = np.flatnonzero(np.bincount(chunks.link_cell, minlength=len(chunks.cell_free_s)) > 1)
    spot = np.full(len(chunks.cell_free_s), -1, np.int64)
    spot[shared] = np.arange(len(shared))
    link = links[spot[chunks.link_cell] >= 0]
    rows.add(
        np.full(len(shared), -np.inf), chunks.cell_free_s[shared].astype(float),
        (spot[chunks.link_cell[link]], at[2] + link, 1.0),
    )  # fmt: skip


def _battery_rows(rows: _Rows, problem: PlanningProblem, chunks: Chunks, chunk_of: IntArray, at: IntArray) -> None:
    """Charge after a chunk is at most charge before plus the chunk's net energy; what exceeds capacity is lost."""
    every = np.arange(len(chunks))
    first = np.isin(every, chunks.offset[:-1])
    collect = np.array([x.collect_w for x in problem.satellites])[chunks.satellite] / 3600.0
    downlink = np.array([x.downlink_w for x in problem.satellites])[chunks.satellite] / 3600.0
    frozen_collect = chunks.frozen_collect.astype(float)
    np.subtract.at(frozen_collect, chunks.image_chunk[problem.frozen_images], 1.0)
    limit = chunks.base_w / 3600.0 * (chunks.end_s - chunks.start_s)
    limit -= frozen_collect * collect + chunks.frozen_downlink * downlink
    limit[chunks.offset[:-1]] += np.array([x.battery_initial_wh for x in problem.satellites])
    rows.add(
        np.full(len(every), -np.inf), limit, (every, at[4] + every, 1.0),
        (every[~first], at[4] + every[~first] - 1, -1.0), (chunk_of, np.arange(len(chunk_of)), collect[chunk_of]),
        (chunks.link_chunk, at[2] + np.arange(len(chunks.link_chunk)), downlink[chunks.link_chunk]),
    )  # fmt: skip


def lagrangian_bound(model: DataCycleModel, dual: FloatArray) -> tuple[float, FloatArray]:
    """Upper bound on the objective from any row multipliers, by weak duality, and the reduced costs.

    Needs no trust in the solver: for max c.v over A v <= b and a box, y.b + max over the box of (c - A'y).v holds for
    every y of the right sign, however inaccurate. Multipliers of the wrong sign are set to zero first.
    """
    dual = np.where((dual > 0) & ~np.isfinite(model.row_high), 0.0, dual)
    dual = np.where((dual < 0) & ~np.isfinite(model.row_low), 0.0, dual)
    side = np.where(dual > 0, model.row_high, np.where(dual < 0, model.row_low, 0.0))
    reduced = model.cost - model.matrix.T @ dual
    box = np.where(reduced > 0, model.high, model.low) * reduced
    value = float(np.sum(dual * side) + np.sum(box))
    return value + BOUND_MARGIN * max(1.0, float(np.abs(box).sum())), reduced
