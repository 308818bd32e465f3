"""The baseline a planner must beat: images in order of their own reward, taken wherever they still fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.planning.coverage import full_coverage, reduce_coverage
from services.planning.data_cycles import Chunks
from services.planning.problem import IntArray, PlanningProblem
from services.planning.search.space import allot_downlinks, construct, energy_binds, search_space

DOWNLINK_SHARES = (1.0, 0.75, 0.5, 0.25)
"""Shares of contact time tried where downlinking in all of it would empty the battery."""


def greedy_images(problem: PlanningProblem, chunks: Chunks) -> IntArray:
    """Images of the greedy baseline: highest total reward first, skipped if they add nothing or do not fit."""
    targets = len(problem.targets.value)
    coverage = reduce_coverage(
        problem, chunks, np.arange(len(problem.images)), np.ones(targets, bool), np.zeros(targets, bool)
    )
    reward = coverage.matrix() @ coverage.value
    sharing = np.bincount(chunks.link_cell, minlength=len(chunks.cell_free_s))[chunks.link_cell]
    links = chunks.cell_free_s[chunks.link_cell] / np.maximum(1, sharing)
    binds = energy_binds(problem, chunks)
    best: IntArray = problem.frozen_images
    for share in DOWNLINK_SHARES if binds else DOWNLINK_SHARES[:1]:
        allotment = allot_downlinks(chunks, links * share, spare=not binds)
        space, order = search_space(problem, chunks, coverage, allotment.per_chunk())
        chosen = construct(space, np.argsort(-reward[order], kind="stable"))
        images = np.sort(coverage.image[order][chosen])
        if problem.objective(images) > problem.objective(best):
            best = images
    return best


def complete(problem: PlanningProblem, chunks: Chunks, images: IntArray, downlink: np.ndarray) -> IntArray:
    """``images`` plus any that still gain something within the downlinks already emitted."""
    total = np.zeros((downlink.shape[0], downlink.shape[1] + 1), np.int64)
    np.cumsum((downlink >= 0) & (problem.frozen.downlink < 0), axis=1, out=total[:, 1:])
    allotted = total[chunks.satellite, chunks.end_s] - total[chunks.satellite, chunks.start_s]
    coverage = full_coverage(problem)
    space, order = search_space(problem, chunks, coverage, allotted)
    # An exact timeline holds ``images``, even where counts per chunk, wary of the order within, would refuse some.
    space = replace(space, fixed=np.isin(order, images))
    reward = coverage.matrix() @ coverage.value
    chosen = construct(space, np.argsort(-reward[order], kind="stable"), minimum=1e-12)
    return np.sort(order[chosen])
