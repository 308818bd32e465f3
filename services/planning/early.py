"""Among plans of equal reward the early one: images that gain nothing go, others move to earlier chances.

A lexicographic preference, applied to a finished plan, so that it can never cost reward: first equation 1, then, for
each image from the last to the first, the earliest other image that covers all that only it covers; then, while
storage, energy and stations bear it, an extra early look at active targets, since a fire seen late is little help.
"""

from __future__ import annotations

import numpy as np

from services.planning.coverage import full_coverage, without_idle
from services.planning.data_cycles import Chunks
from services.planning.problem import IntArray, PlanningProblem
from services.planning.search.kernels import satellite_ok
from services.planning.search.space import search_space


class _Choice:
    """A set of images with cover counts, and the resource check under the downlinks of a timeline."""

    def __init__(self, problem: PlanningProblem, chunks: Chunks, images: IntArray, downlink: np.ndarray) -> None:
        self.problem, self.chunk = problem, chunks.image_chunk
        own, targets = problem.images, problem.targets
        total = np.zeros((downlink.shape[0], downlink.shape[1] + 1), np.int64)
        np.cumsum((downlink >= 0) & (problem.frozen.downlink < 0), axis=1, out=total[:, 1:])
        allotted = total[chunks.satellite, chunks.end_s] - total[chunks.satellite, chunks.start_s]
        self.space, _ = search_space(problem, chunks, full_coverage(problem), allotted)
        self.counts = targets.counted()
        self.chosen = np.zeros(len(own), bool)
        self.chosen[images] = True
        self.fixed = np.zeros(len(own), bool)
        self.fixed[problem.frozen_images] = True
        self.cover = np.zeros(len(targets.value), np.int64)
        np.add.at(self.cover, own.target[self.chosen[own.image_of_entry()]], 1)
        self.count = np.bincount(self.chunk[images], minlength=len(chunks)).astype(np.int64)

    def put(self, image: int, sign: int) -> None:
        self.chosen[image] = sign > 0
        self.count[self.chunk[image]] += sign
        self.cover[self.problem.images.covered(image)] += sign

    def fits(self, *images: int) -> bool:
        """Whether the satellites of ``images`` bear their present counts."""
        own = {int(self.problem.images.satellite[image]) for image in images}
        space = self.space
        return all(satellite_ok(s, self.count, space.chunk_offset, space.chunk_numbers, space.limits) for s in own)

    def sole(self, image: int) -> IntArray:
        """Targets that matter and that no other chosen image covers."""
        covered = self.problem.images.covered(image)
        return covered[(self.cover[covered] == 1) & self.counts[covered]]

    def redundant_out(self) -> None:
        images = np.flatnonzero(self.chosen)
        for image in np.setdiff1d(images, without_idle(self.problem, images, np.flatnonzero(self.fixed))).tolist():
            self.put(image, -1)


def earlier_images(problem: PlanningProblem, chunks: Chunks, images: IntArray, downlink: np.ndarray) -> IntArray:
    """``images`` without those that gain nothing, moved early where nothing is lost; all targets stay covered."""
    choice = _Choice(problem, chunks, images, downlink)
    by_target, seen_start = _images_of_targets(problem)
    choice.redundant_out()
    second = problem.images.second
    order = np.flatnonzero(choice.chosen & ~choice.fixed)
    for image in order[np.argsort(-second[order], kind="stable")]:
        _replace_earlier(choice, int(image), by_target, seen_start)
    _look_early(choice, by_target, seen_start)
    choice.redundant_out()
    return np.flatnonzero(choice.chosen)


def _images_of_targets(problem: PlanningProblem) -> tuple[IntArray, IntArray]:
    """Images of every target in order of time, as CSR."""
    image = problem.images.image_of_entry()
    order = np.lexsort((problem.images.second[image], problem.images.target))
    start = np.searchsorted(problem.images.target[order], np.arange(len(problem.targets.value) + 1))
    return image[order], start


def _replace_earlier(choice: _Choice, image: int, by_target: IntArray, seen_start: IntArray) -> None:
    sole = choice.sole(image)
    if not len(sole):
        return
    rarest = sole[np.argmin(seen_start[sole + 1] - seen_start[sole])]
    own, sought = choice.problem.images, set(sole.tolist())
    for other in by_target[seen_start[rarest] : seen_start[rarest + 1]].tolist():
        if own.second[other] >= own.second[image]:
            return
        if choice.chosen[other] or not sought.issubset(own.covered(other).tolist()):
            continue
        choice.put(image, -1)
        choice.put(other, 1)
        if choice.fits(image, other):
            return
        choice.put(other, -1)
        choice.put(image, 1)


def _look_early(choice: _Choice, by_target: IntArray, seen_start: IntArray) -> None:
    """Extra images for active targets whose first planned look is not their earliest possible one."""
    problem = choice.problem
    for target in np.flatnonzero(problem.targets.active & (choice.cover > 0)).tolist():
        for image in by_target[seen_start[target] : seen_start[target + 1]].tolist():
            if choice.chosen[image]:
                break
            choice.put(image, 1)
            if choice.fits(image):
                choice.fixed[image] = True  # what it covers is covered later too, yet it does not go as useless
                break
            choice.put(image, -1)


def first_looks(problem: PlanningProblem, images: IntArray) -> IntArray:
    """Second of the first planned image of every target (-1: none)."""
    own = problem.images
    chosen = np.zeros(len(own), bool)
    chosen[images] = True
    entry = chosen[own.image_of_entry()]
    first = np.full(len(problem.targets.value), problem.horizon_s, np.int64)
    np.minimum.at(first, own.target[entry], own.second[own.image_of_entry()[entry]])
    return np.where(first == problem.horizon_s, -1, first)
