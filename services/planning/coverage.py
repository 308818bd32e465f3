"""Coverage reduced to what decides: targets seen by the same images merged, images that cannot help dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from services.planning.data_cycles import Chunks
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem


@dataclass(frozen=True)
class Coverage:
    """Images (``image``: index into the problem) by target groups, as CSR: ``start``, ``group``.

    ``value`` is a group's summed objective value, ``required`` whether it must be covered, ``group_of`` the group of
    every target (-1: nothing here sees it, or it is left out).
    """

    image: IntArray
    start: IntArray
    group: IntArray
    value: FloatArray
    required: BoolArray
    group_of: IntArray

    def matrix(self) -> sparse.csr_array:
        """0/1 matrix, images by groups."""
        ones = np.ones(len(self.group))
        return sparse.csr_array((ones, self.group, self.start), shape=(len(self.image), len(self.value)))


def full_coverage(problem: PlanningProblem) -> Coverage:
    """Nothing merged, nothing dropped: group g is target g."""
    own, targets = problem.images, len(problem.targets.value)
    return Coverage(
        np.arange(len(own)), own.start, own.target, problem.targets.value, np.zeros(targets, bool), np.arange(targets)
    )


def without_idle(problem: PlanningProblem, images: IntArray, held: IntArray) -> IntArray:
    """``images`` less those that observe nothing by themselves, the last looked at first (``held`` stay)."""
    own, counted = problem.images, problem.targets.counted()
    chosen = np.zeros(len(own), bool)
    chosen[images] = True
    cover = np.bincount(own.target[chosen[own.image_of_entry()]], minlength=len(counted))
    free = np.setdiff1d(images, held)
    for image in free[np.argsort(-own.second[free], kind="stable")].tolist():
        covered = own.covered(image)
        if not ((cover[covered] == 1) & counted[covered]).any():
            chosen[image] = False
            cover[covered] -= 1
    return np.flatnonzero(chosen)


def reduce_coverage(
    problem: PlanningProblem,
    chunks: Chunks,
    candidates: IntArray,
    counted: BoolArray,
    required: BoolArray,
) -> Coverage:
    """Merge and drop, over ``candidates`` (image indices) and the targets in ``counted``.

    Targets covered by exactly the same candidates become one group. An image whose targets are a subset of another's in
    the same chunk is dropped: swapping it for the other changes no chunk total, so an optimal plan without it exists.
    Frozen images are never dropped. Rewardless targets are left out unless required.
    """
    use = counted & ((problem.targets.value > 0) | required)
    matrix = _incidence(problem, candidates)[:, np.flatnonzero(use)]
    group, groups = _same_columns(matrix)
    group_of = np.full(len(use), -1, np.int64)
    group_of[np.flatnonzero(use)] = group
    seen = group >= 0
    value = np.bincount(group[seen], problem.targets.value[use][seen], minlength=groups)
    needed = np.bincount(group[seen], required[use][seen], minlength=groups) > 0
    merged = _incidence_of_groups(matrix, group, groups)
    frozen = np.isin(candidates, problem.frozen_images)
    keep = _undominated(merged, chunks.image_chunk[candidates], frozen)
    merged = sparse.csr_array(merged[np.flatnonzero(keep)])
    merged.sort_indices()
    return Coverage(
        candidates[keep], merged.indptr.astype(np.int64), merged.indices.astype(np.int64), value, needed, group_of
    )


def _incidence(problem: PlanningProblem, candidates: IntArray) -> sparse.csc_array:
    images = problem.images
    everything = sparse.csr_array(
        (np.ones(len(images.target), np.int32), images.target, images.start),
        shape=(len(images), len(problem.targets.value)),
    )
    return sparse.csc_array(everything[candidates])


def _same_columns(matrix: sparse.csc_array) -> tuple[IntArray, int]:
    """Group number of every column by its set of rows (-1: empty), numbered in order of first column."""
    rng = np.random.default_rng(20250108)
    marks = rng.integers(0, 2**63, (matrix.shape[0], 2), dtype=np.uint64)
    sizes = np.diff(matrix.indptr)
    column = np.repeat(np.arange(matrix.shape[1]), sizes)
    keys = np.zeros((matrix.shape[1], 3), np.uint64)
    for side in range(2):  # 128 random bits a row, added modulo 2^64: equal sums mean equal sets for all practical ends
        np.add.at(keys[:, side], column, marks[matrix.indices, side])
    keys[:, 2] = sizes
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    filled = np.flatnonzero(sizes[first] > 0)
    rank = np.full(len(first), -1, np.int64)
    rank[filled[np.argsort(first[filled], kind="stable")]] = np.arange(len(filled))
    return rank[inverse.reshape(-1)], len(filled)


def _incidence_of_groups(matrix: sparse.csc_array, group: IntArray, groups: int) -> sparse.csr_array:
    _, first = np.unique(group, return_index=True)
    first = first[group[first] >= 0]
    return sparse.csr_array(matrix[:, first]) if groups else sparse.csr_array((matrix.shape[0], 0), dtype=np.int32)


def _undominated(matrix: sparse.csr_array, chunk: IntArray, frozen: BoolArray) -> BoolArray:
    """Images not covered by another of their chunk (of equals, frozen first, then the earliest, stays)."""
    size = np.diff(matrix.indptr)
    keep = (size > 0) | frozen
    if not matrix.nnz:
        return keep
    entries = np.repeat(np.arange(matrix.shape[0]), size)
    _, place = np.unique(chunk[entries] * matrix.shape[1] + matrix.indices, return_inverse=True)
    by_chunk = sparse.csr_array((np.ones(len(place), np.int32), place.reshape(-1), matrix.indptr))
    overlap = sparse.coo_array(by_chunk @ by_chunk.T)
    subset, other = overlap.coords
    whole = (overlap.data == size[subset]) & (subset != other)
    equal = size[subset] == size[other]
    wins = np.where(frozen[subset] == frozen[other], other < subset, frozen[other])
    dominated = whole & (~equal | wins) & ~frozen[subset]
    keep[subset[dominated]] = False
    return keep
