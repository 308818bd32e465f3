"""Odd-set inequalities: what the relaxation of coverage claims and no set of whole images can do.

Half an image here and half an image there cover every group that both see. Three images of which every two share a
group cover those three groups as halves, one and a half images in all, where whole images need two. For any odd set R
of groups, with c_i of them seen by image i, adding half of every row x_g <= sum of w_i and half of every x_g <= 1, and
rounding down, gives

    sum over R of x_g  <=  (|R| - 1) / 2  +  sum of ceil(c_i / 2) w_i

for every set of whole images (zero-half cuts: Caprara and Fischetti, Mathematical Programming 74, 1996). A point breaks
it by half of what one exceeds: the w of images that see an odd number of R's groups, and what R's own rows leave open.
Such sets are sought as odd cycles: images are nodes, a group an edge between any two that see it, and what other images
add its length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from services.planning.problem import FloatArray, IntArray

PRESENT = 1e-4
"""Images below this share of a point are no nodes; they still count in every inequality."""
MOST_IMAGES = 16
"""Groups seen by more images of a point than this are no edges: the rest of them would be too long."""
REACH = 1.2
"""Longest cycle looked at: 1 is where an inequality by itself is no longer broken, but the length counts an image twice
where the inequality need not count it at all."""
LEAST_VIOLATION = 0.01
PARALLEL = 2
"""Groups tried as the edge between the same two images, shortest first."""
SOURCES = 400
"""Nodes whose distances are held in memory at a time."""


@dataclass(frozen=True)
class _Edges:
    """Edges between images ``a`` < ``b`` by ``group``, with their ``length``."""

    a: IntArray
    b: IntArray
    group: IntArray
    length: FloatArray

    def among(self, keep: IntArray) -> _Edges:
        return _Edges(self.a[keep], self.b[keep], self.group[keep], self.length[keep])


def odd_set_rows(seen: sparse.csr_array, sets: sparse.csr_array, columns: int) -> tuple[sparse.csr_array, FloatArray]:
    """The inequalities of ``sets`` (0/1, sets by groups) as rows over the model's columns, and their upper sides.

    ``seen`` (images by groups) is the coverage; columns are (images, groups, others), ``columns`` in all.
    """
    images, groups = seen.shape
    weight = sparse.csr_array(sets @ seen.T)
    weight.data = -np.ceil(weight.data / 2)
    rest = sparse.csr_array((sets.shape[0], columns - images - groups))
    rows = sparse.csr_array(sparse.hstack([weight, sets, rest]))
    return rows, (sets.sum(axis=1) - 1) / 2


def violated_odd_sets(
    seen: sparse.csr_array, image: FloatArray, group: FloatArray, reach: float = REACH
) -> sparse.csr_array:
    """Odd sets (0/1, sets by groups) whose inequality the point breaks, worst first.

    ``image`` and ``group`` are the relaxation's w and x. One shortest odd cycle through every image is looked at, by
    the shortest and by the second shortest edges between any two: not all violated sets are found.
    """
    covered = seen.T @ image
    edges = _edges(seen, image, group, covered, reach)
    found: set[tuple[int, ...]] = set()
    for rank in range(PARALLEL):
        found |= _odd_cycles(edges.among(_of_rank(edges, rank)), reach)
    sets = _as_rows(sorted(found), seen.shape[1])
    odd = sparse.csr_array(sets @ seen.T)
    odd.data = np.mod(odd.data, 2.0)
    exceeding = odd @ image + sets @ (1 - group + np.maximum(0.0, covered - group))
    keep = np.flatnonzero(exceeding < 1 - 2 * LEAST_VIOLATION)
    return sets[keep[np.argsort(exceeding[keep], kind="stable")]]


def _as_rows(sets: list[tuple[int, ...]], groups: int) -> sparse.csr_array:
    start = np.concatenate([[0], np.cumsum([len(odd) for odd in sets])]).astype(np.int64)
    member = np.array([g for odd in sets for g in odd], np.int64)
    return sparse.csr_array((np.ones(len(member)), member, start), shape=(len(sets), groups))


def _edges(seen: sparse.csr_array, image: FloatArray, group: FloatArray, covered: FloatArray, reach: float) -> _Edges:
    """Edges shorter than ``reach``: what a group's row leaves open, and the w of all its images but the two."""
    present = np.flatnonzero(image > PRESENT)
    inside = sparse.csc_array(seen[present])
    size = np.diff(inside.indptr)
    base = np.maximum(0.0, covered - group) + 1 - group + covered
    parts = []
    for count in range(2, MOST_IMAGES + 1):
        chosen = np.flatnonzero(size == count)
        members = present[inside.indices[inside.indptr[chosen][:, None] + np.arange(count)]]
        i, j = np.triu_indices(count, 1)
        a, b = members[:, i], members[:, j]
        length = base[chosen][:, None] - image[a] - image[b]
        near = length < reach
        of = np.broadcast_to(chosen[:, None], length.shape)
        parts.append((np.minimum(a, b)[near], np.maximum(a, b)[near], of[near], np.maximum(length[near], 1e-6)))
    return _Edges(*(np.concatenate([part[k] for part in parts]) for k in range(4)))


def _of_rank(edges: _Edges, rank: int) -> IntArray:
    """Of all edges between the same two images, the one of this rank in length."""
    order = np.lexsort((edges.group, edges.length, edges.b, edges.a))
    a, b = edges.a[order], edges.b[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (a[1:] != a[:-1]) | (b[1:] != b[:-1])
    first = np.flatnonzero(fresh)
    place = np.arange(len(order)) - np.repeat(first, np.diff(np.append(first, len(order))))
    return order[place == rank]


def _odd_cycles(edges: _Edges, reach: float) -> set[tuple[int, ...]]:
    """Groups of a shortest odd cycle through every node, if shorter than ``reach``: a path between a node's two copies
    in the graph whose every edge leads from one copy of the nodes to the other."""
    if not len(edges.a):
        return set()
    nodes, place = np.unique(np.concatenate([edges.a, edges.b]), return_inverse=True)
    count = len(nodes)
    a, b = place[: len(edges.a)], place[len(edges.a) :]
    ends = (np.concatenate([a, b, a + count, b + count]), np.concatenate([b + count, a + count, b, a]))
    graph = sparse.csr_array((np.tile(edges.length, 4), ends), shape=(2 * count, 2 * count))
    both = (np.concatenate([a, b]), np.concatenate([b, a]))
    group_of = sparse.csr_array((np.tile(edges.group + 1, 2), both), shape=(count, count))
    found: set[tuple[int, ...]] = set()
    for begin in range(0, count, SOURCES):
        source = np.arange(begin, min(count, begin + SOURCES))
        distance, before = dijkstra(graph, indices=source, return_predecessors=True, limit=reach)
        ending = np.flatnonzero(np.isfinite(distance[np.arange(len(source)), source + count]))
        found |= _read_back(before[ending], source[ending], count, group_of)
    return found


def _read_back(before: IntArray, source: IntArray, count: int, group_of: sparse.csr_array) -> set[tuple[int, ...]]:
    """The groups met an odd number of times on each path from ``source`` to its other copy."""
    paths: list[list[int]] = [[] for _ in source]
    node, live = source + count, np.arange(len(source))
    while len(live):
        back = before[live, node[live]]
        met = np.asarray(group_of[back % count, node[live] % count]).ravel() - 1
        for path, group in zip(live, met, strict=True):
            paths[path].append(int(group))
        node[live] = back
        live = live[back != source[live]]
    odd = (np.unique(path, return_counts=True) for path in paths)
    sets = (tuple(group[times % 2 == 1].tolist()) for group, times in odd)
    return {groups for groups in sets if len(groups) >= 3 and len(groups) % 2}
