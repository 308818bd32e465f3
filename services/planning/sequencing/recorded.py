"""A plan made of recordings, with its bound: by the program over seconds, or by windows and search where that is too
large."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from services.planning.bugs import PlanningBugError
from services.planning.downlinks import emit_timeline
from services.planning.options.rules import OperationRules
from services.planning.planner import Options, Plan, Progress, plan
from services.planning.problem import BoolArray, IntArray, PlanningProblem
from services.planning.sequencing.passes import spare_downlinks
from services.planning.sequencing.recording_program import ChosenRecordings, RecordingProgram
from services.planning.sequencing.sequence import is_small, one_pointing, sequence, with_fillers
from services.planning.work import Clock

GUIDE_SHARE = 0.5
"""Share of work and time for the plan by totals, where recordings are searched after it."""
BOUND_SHARE, POLISH_SHARE = 0.05, 0.35
"""Shares of the work where windows guide the search: for the plan by totals, of which little more than its bound is
wanted, and for the search over seconds. The rest is the program's, whose work is counted in nodes."""
GAP = 5e-4
"""What the program over windows may leave, relative to its bound, unless less is asked for."""
TOLERANCE = 1e-6
"""Relative: how far a plan's worth may lie above its bound by rounding."""
THIS_CASE = "this case"
WITHOUT_SEQUENCE = "the same case without recordings, switches and slews"
RECORDINGS_ALONE = "the same case with the shortest recording alone of all rules of sequence"


@dataclass(frozen=True)
class _Lead:
    """Where the search over seconds starts: images and downlinks on ``problem``, recordings (None: none yet).

    ``guide`` is the problem that the plan by totals was made of.
    """

    guide: PlanningProblem
    problem: PlanningProblem
    images: IntArray
    downlink: np.ndarray
    begin: IntArray | None
    chosen: ChosenRecordings | None


def recorded(
    wished: PlanningProblem, rules: OperationRules, options: Options, progress: Progress
) -> tuple[PlanningProblem, Plan, str]:
    """A plan that keeps the rules of sequence, the problem with the seconds it only runs through, and what its bound
    is the bound of."""
    left = Clock(time.monotonic(), options.time_limit_s).left
    required, pinned = _required(wished, options), wished.targets.demanded()
    found, lead = _guidance(wished, rules, options, required, left, progress)
    progress(82, "recordings")
    asked = required
    if lead.begin is not None and not lead.problem.covered_targets(lead.images)[required].all():
        # Not all can be met: equation 1 decides, or no exchange would ever be tried that gives one of them up.
        asked = required & pinned
    work = options.work_limit * (1 - GUIDE_SHARE if lead.begin is None else POLISH_SHARE)
    best = sequence(
        wished, rules, lead.problem, lead.images, lead.downlink, asked, work, left, lead.begin
    )  # fmt: skip
    objective = best.problem.objective(best.timeline.images)
    met = bool(best.problem.covered_targets(best.timeline.images)[required].all())
    found = _without_demand(found, lead, best.bound, met, options, left)
    bound, bound_of = _bound(found, lead.chosen, best.bound, rules, wished, met)
    if bound < objective - TOLERANCE * max(1.0, abs(objective)):
        raise PlanningBugError(f"the plan is worth {objective}, more than the {bound} proven for {bound_of}")
    # A search that misses one proves nothing; a plan that not even fewer rules leave room for does.
    refuted = found.mandatory_possible is False or (np.isfinite(best.bound) and not best.time_limited)
    refuted |= lead.chosen is not None and lead.chosen.possible is False
    held = wished.covered_targets(wished.frozen_images) & required
    most = None if lead.chosen is None else lead.chosen.most + int(held.sum())
    made = replace(
        found, timeline=best.timeline, objective=objective, bound=max(objective, bound),
        method=best.method if lead.begin is None else "integer program over windows, " + best.method,
        mandatory=found.mandatory and met,
        mandatory_possible=found.mandatory_possible if met else (False if refuted else None),
        time_limited=found.time_limited or best.time_limited or (lead.chosen is not None and lead.chosen.time_limited),
        mandatory_most=most,
    )  # fmt: skip
    return best.problem, made, bound_of


def _guidance(
    wished: PlanningProblem, rules: OperationRules, options: Options, required: BoolArray,
    left: Callable[[], float], progress: Progress,
) -> tuple[Plan, _Lead]:  # fmt: skip
    """The plan by totals, and what leads the search."""
    guide = one_pointing(wished) if len(wished.pointings) > 1 else wished
    program = None
    if rules.min_collect_s > 1 and not is_small(wished):
        program = RecordingProgram(wished, rules.min_collect_s)
    share = BOUND_SHARE if program is not None and program.windows is not None else GUIDE_SHARE
    limited = replace(options, time_limit_s=left() * GUIDE_SHARE, work_limit=options.work_limit * share)
    with ThreadPoolExecutor(max_workers=2) as pool:
        task = pool.submit(plan, guide, limited, progress)
        pinned = wished.targets.demanded()
        chosen = None
        if program is not None:
            chosen = program.solve(required, pinned, min(GAP, options.mip_gap), left)
        found = task.result()
    if program is None or chosen is None or chosen.recording is None:
        return found, _Lead(guide, guide, found.timeline.images, found.timeline.downlink, None, chosen)
    begin, own = chosen.recording, wished.images
    images = np.flatnonzero(begin[own.satellite, own.second] == own.pointing_of())
    full, recorded_seconds = with_fillers(wished, begin)
    sent = emit_timeline(full, recorded_seconds, required)
    spare = rules.free_downlinks and not program.energy
    downlink = spare_downlinks(wished, begin, sent.downlink) if spare else sent.downlink
    chosen = replace(chosen, time_limited=chosen.time_limited or sent.time_limited)
    return found, _Lead(guide, wished, images, downlink, begin, chosen)


def _without_demand(
    found: Plan, lead: _Lead, exact: float, met: bool, options: Options, left: Callable[[], float]
) -> Plan:
    """``found`` with a bound that holds for the plan returned too, if that misses targets which ``found`` had to meet.

    That bound holds for plans alone that meet them all, and one that gives some up may be worth more. Nothing is
    planned again where the rules' own programs prove a bound without them.
    """
    demanded = found.mandatory_possible is True and options.active_mandatory != "false"
    if met or not demanded:
        return found
    if np.isfinite(exact) or (
        lead.chosen is not None and np.isfinite(lead.chosen.bound) and not lead.chosen.all_demanded
    ):
        return replace(found, bound=float("inf"))
    work = options.work_limit * BOUND_SHARE
    free = plan(lead.guide, replace(options, active_mandatory="false", time_limit_s=left(), work_limit=work))
    return replace(found, bound=free.bound, time_limited=found.time_limited or free.time_limited)


def _bound(
    found: Plan, chosen: ChosenRecordings | None, exact: float, rules: OperationRules, wished: PlanningProblem,
    met: bool,
) -> tuple[float, str]:  # fmt: skip
    """The tightest bound known and what it is the bound of."""
    if np.isfinite(exact):
        return min(found.bound, exact), THIS_CASE
    if chosen is None or chosen.bound >= found.bound or (chosen.all_demanded and not met):
        return found.bound, WITHOUT_SEQUENCE
    alone = rules.free_downlinks and len(wished.pointings) < 2
    return chosen.bound, THIS_CASE if alone else RECORDINGS_ALONE


def _required(problem: PlanningProblem, options: Options) -> BoolArray:
    seen = problem.covered_targets(np.arange(len(problem.images)))
    wanted = problem.targets.demanded()
    if options.active_mandatory != "false":
        wanted = wanted | problem.targets.active
    return wanted & seen
