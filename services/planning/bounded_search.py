"""The search of large cases, with its guidance before it and the tighter bound beside it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from services.planning.coverage import Coverage
from services.planning.data_cycles import Chunks
from services.planning.greedy import greedy_images
from services.planning.guidance import Guidance, exact_guidance, is_large, rough_guidance
from services.planning.milp import DataCycleModel
from services.planning.problem import IntArray, PlanningProblem
from services.planning.search.guided import Start, quick_plan, refined_plan, search_plan, search_start
from services.planning.solving import Solution, trivial_bound
from services.planning.tightening import tightened_bound
from services.planning.work import Clock, Work

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class _Guided:
    """The quick search's guidance and plan, the interior point's guidance (None: too large, or cut) and the start."""

    rough: Guidance
    known: IntArray
    better: Guidance | None
    start: Start

    @property
    def bound(self) -> float:
        return min(self.rough.bound, self.better.bound if self.better is not None else np.inf)


def search_with_bound(
    problem: PlanningProblem, chunks: Chunks, coverage: Coverage, model: DataCycleModel, seed: IntArray | None,
    first: Solution | None, work: Work, clock: Clock, progress: Progress,
) -> tuple[IntArray, float, bool]:  # fmt: skip
    """Images, proven bound and whether time cut it. ``first`` is what branch and bound left of a small case."""
    greedy = greedy_images(problem, chunks)
    bound = min(trivial_bound(model), first.bound if first is not None else np.inf)
    _tell(progress, 16, "relaxation", problem.objective(greedy), bound)
    guided = _guided(problem, chunks, coverage, model, seed, work, clock)
    known, better = guided.known, guided.better
    proven = [min(bound, guided.bound)]

    def guard(done: int, images: IntArray) -> bool:
        shown = max(problem.objective(images), problem.objective(known))
        _tell(progress, 45 + 35 * done / max(1, work.moves), f"search {done}/{work.moves} steps", shown, min(proven))
        return clock.left() <= 0

    with ThreadPoolExecutor(max_workers=1) as pool:
        proof = better and pool.submit(
            tightened_bound, better.model, chunks, coverage, better.relaxation, work.proofs, clock.left, proven.append
        )
        images, cut = search_plan(guided.start, work.moves, guard, clock.left)
        images, late = refined_plan(
            guided.start, images, work.halves, lambda done, images: guard(work.moves, images), clock.left
        )
        tighter, short = proof.result() if proof else (np.inf, not is_large(coverage))
    cut |= late or short or guided.rough.time_limited
    cut |= any(found is not None and found.time_limited for found in (better, first))
    candidates = [images, known] if seed is not None else [images, known, greedy]
    return max(candidates, key=problem.objective), min(*proven, tighter), cut


def _guided(
    problem: PlanningProblem, chunks: Chunks, coverage: Coverage, model: DataCycleModel, seed: IntArray | None,
    work: Work, clock: Clock,
) -> _Guided:  # fmt: skip
    """The interior point on one core, rough guidance and a quick search on the other."""

    def quick() -> tuple[Guidance, Start, IntArray]:
        rough = rough_guidance(model, chunks, coverage, clock.left)
        start = search_start(problem, chunks, coverage, rough.relaxation, rough.quotas, seed)
        return rough, start, quick_plan(start, work.moves, clock.left)

    with ThreadPoolExecutor(max_workers=1) as pool:
        task = pool.submit(quick)
        better = None if is_large(coverage) else exact_guidance(model, chunks, coverage, clock.left)
        rough, start, known = task.result()
    if better is not None:
        start = search_start(problem, chunks, coverage, better.relaxation, better.quotas, seed)
    return _Guided(rough, known, better, start)


def _tell(progress: Progress, percent: float, stage: str, incumbent: float, bound: float) -> None:
    gap = max(0.0, 1 - incumbent / bound) if bound > 0 else 0.0
    progress(percent, f"{stage}, incumbent {incumbent:.7g}, bound {bound:.7g}, gap {100 * gap:.3f} %")
