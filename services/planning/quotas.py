"""Whole images per chunk: a small integer program over totals only, as guidance and as a tighter bound than the LP.

With multipliers y on the coverage rows (equation 2) and on the cuts, every image is worth what it adds to them, and
what a chunk collects depends on its number of images only: the sum S_c(n) of its n dearest. The best whole n and
downlinks for sum of S_c(n_c), plus what the groups' rewards exceed their multipliers, bound every plan (Lagrangian
relaxation, Geoffrion 1974, doi:10.1007/BFb0120690); the relaxation's own optimum is the same with fractional n, so this
bound is never weaker.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.milp import BOUND_MARGIN, DataCycleModel
from services.planning.problem import FloatArray, IntArray
from services.planning.solving import Solution, branch_and_bound

NEAR = 5
"""Counts this near to the relaxation's have a tangent each; farther ones get a few."""
CURVATURE = 0.02
"""Loss of an image's worth per image of distance from the relaxation's count, in the guiding program: the tangents
alone are flat where many images tie, and the quotas would wander."""
GUIDE_NODES, BOUND_NODES = 5, 10
GUIDE_GAP_IMAGES, BOUND_GAP = 4.0, 1e-5
SLACK = 1e-5
"""How far rows may be missed, in reward: heights run to ten thousands, where HiGHS' own 1e-6 is below its rounding, and
it then repairs its solutions and prints a line about each. The bound allows for it."""


@dataclass(frozen=True)
class Quotas:
    """Whole images per chunk and downlink seconds per link; ``bound`` on the objective of any plan."""

    images: IntArray
    links: FloatArray
    bound: float
    feasible: bool
    time_limited: bool


@dataclass(frozen=True)
class _Worth:
    """Per chunk with images: chunk number, prefix sums of worth, images forced and the relaxation's count."""

    chunk: IntArray
    column: IntArray
    prefix: list[FloatArray]
    forced: IntArray
    relaxed: FloatArray
    constant: float


def _worth(model: DataCycleModel, chunks: Chunks, coverage: Coverage, relaxation: Solution, dual: FloatArray) -> _Worth:
    y = np.maximum(0.0, dual[: model.priced])
    reduced = model.cost - model.matrix[: model.priced].T @ y
    box = slice(model.images, model.images + model.groups)
    constant = np.append(np.where(reduced[box] > 0, model.high[box], model.low[box]) * reduced[box],
                         y * model.row_high[: model.priced])  # fmt: skip
    price = reduced[: model.images]
    chunk_of = chunks.image_chunk[coverage.image]
    used, column = np.unique(chunk_of, return_index=True)
    fixed = model.low[: model.images] > 0
    prefix, forced = [], []
    for chunk in used:
        mine = np.flatnonzero(chunk_of == chunk)
        held, rest = price[mine[fixed[mine]]], price[mine[~fixed[mine]]]
        prefix.append(np.concatenate([[0.0], np.cumsum(np.concatenate([held, -np.sort(-rest)]))]))
        forced.append(len(held))
    relaxed = np.bincount(chunk_of, relaxation.images, minlength=len(chunks))[used]
    total = float(constant.sum()) + BOUND_MARGIN * max(1.0, float(np.abs(constant).sum()))
    # An interior point that was cut may lie outside its bounds.
    relaxed = np.clip(relaxed, 0, [len(sums) - 1 for sums in prefix])
    return _Worth(used, column, prefix, np.array(forced, np.int64), relaxed, total)


def _tangents(worth: _Worth, curvature: float) -> tuple[sparse.csr_array, FloatArray]:
    """Rows z_c - slope n_c <= height over columns (n, z): lines through neighbouring points of the concave S_c."""
    rows, columns, values, height = [], [], [], []
    count = len(worth.chunk)
    for k, prefix in enumerate(worth.prefix):
        most = len(prefix) - 1
        centre = int(worth.relaxed[k])
        near = range(centre - NEAR, centre + NEAR + 1)
        far = (centre // 2, centre - 4 * NEAR, centre - 2 * NEAR, centre + 2 * NEAR, centre + 4 * NEAR, most - 1)
        points = np.array(sorted({int(worth.forced[k]), *near, *far}))
        points = points[(points >= worth.forced[k]) & (points < most)]
        bend = curvature * (prefix[min(most, centre + 1)] - prefix[min(most - 1, centre)])
        here, there = (prefix[x] - bend * (x - worth.relaxed[k]) ** 2 / 2 for x in (points, points + 1))
        slope = there - here
        rows.append(np.repeat(np.arange(len(points)) + len(height), 2))
        columns.append(np.tile([count + k, k], len(points)))
        values.append(np.column_stack([np.ones(len(points)), -slope]).ravel())
        height += (here - slope * points).tolist()
    triplets = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(triplets, shape=(len(height), 2 * count)), np.array(height)


def _model(model: DataCycleModel, worth: _Worth, curvature: float) -> DataCycleModel:
    """Columns (n, z, d, u, b): the resource rows of ``model`` with its images counted per chunk, and the tangents."""
    count, begin = len(worth.chunk), model.images + model.groups
    resources = sparse.csc_array(model.matrix[model.priced :])
    tangents, height = _tangents(worth, curvature)
    matrix = sparse.csr_array(sparse.block_array([
        [resources[:, worth.column], sparse.csc_array((resources.shape[0], count)), resources[:, begin:]],
        [tangents[:, :count], tangents[:, count:], None],
    ]))  # fmt: skip
    matrix.sort_indices()
    size = np.array([len(prefix) - 1 for prefix in worth.prefix], float)
    top = np.array([prefix[-1] for prefix in worth.prefix]) + 1.0
    rest = np.zeros(matrix.shape[1] - 2 * count)
    return DataCycleModel(
        np.concatenate([np.zeros(count), np.ones(count), rest]), matrix,
        np.concatenate([model.row_low[model.priced :], np.full(len(height), -np.inf)]),
        np.concatenate([model.row_high[model.priced :], height]),
        np.concatenate([worth.forced, np.full(count, -10.0 * top.sum()), model.low[begin:]]),
        np.concatenate([size, top, model.high[begin:]]), count, count, model.links,
    )  # fmt: skip


def _solved(
    model: DataCycleModel, chunks: Chunks, worth: _Worth, guide: bool, time_limit_s: float, exact: bool
) -> tuple[IntArray, Solution]:
    small = _model(model, worth, CURVATURE if guide else 0.0)
    whole = np.zeros(len(small.cost), bool)
    whole[: small.images] = exact
    at = worth.relaxed.astype(int)
    last = [p[min(len(p) - 1, n + 1)] - p[min(len(p) - 2, n)] for p, n in zip(worth.prefix, at, strict=True)]
    total = max(1e-9, sum(float(p[n]) for p, n in zip(worth.prefix, at, strict=True)))
    gap = GUIDE_GAP_IMAGES * float(np.median(last)) / total if guide else BOUND_GAP
    nodes = GUIDE_NODES if guide else BOUND_NODES
    solution = branch_and_bound(small, whole, max(1e-7, gap), nodes, time_limit_s, SLACK)
    images = np.zeros(len(chunks), np.int64)
    images[worth.chunk] = np.floor(solution.images + 1e-6)
    return images, solution


def whole_quotas(
    model: DataCycleModel, chunks: Chunks, coverage: Coverage, relaxation: Solution, guide: bool, time_limit_s: float,
    exact: bool = True,
) -> Quotas:  # fmt: skip
    """Quotas near the relaxation's (``guide``), or wherever they prove the tightest bound.

    Without ``exact`` counts may be fractional in the program, and are rounded down: quicker, with a looser bound.
    """
    if relaxation.dual is None or not model.images:
        return Quotas(np.zeros(len(chunks), np.int64), relaxation.links, relaxation.bound, False, False)
    worth = _worth(model, chunks, coverage, relaxation, relaxation.dual)
    images, solution = _solved(model, chunks, worth, guide, time_limit_s, exact)
    proven = relaxation.bound
    if not guide and solution.feasible:
        proven = min(proven, worth.constant + solution.bound + 2 * SLACK * len(worth.chunk))
    links = solution.links if solution.feasible else relaxation.links
    return Quotas(images, links, proven, solution.feasible, solution.time_limited)
