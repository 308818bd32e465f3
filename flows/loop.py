"""The 24-hour loop: prioritise → predict access → plan → uplink → execute → retrieve → infer arrival → publish.

Pure orchestration over a Runner: no Prefect, no HTTP, no clock. What a cycle hands to the next is a Handover; what the
next cycle takes from it is a set of feedbacks, so that each can be removed and its effect seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

from flows.desk.approval import CycleUnderWay, Desk, NobodyDecides
from flows.loop_types import CaseInputs, CycleProducts, Handover, LoopSettings, cycle_label
from flows.runner import Runner
from flows.stages import decide, observe, plan, prioritise, understand

SOIL_MEMORY_H = 72  # older soil moisture says little about the day ahead


def run_cycle(
    runner: Runner,
    case: CaseInputs,
    cutoff: datetime,
    before: Handover,
    feedback: frozenset[str],
    settings: LoopSettings,
    desk: Desk | None = None,
    now: datetime | None = None,
) -> CycleProducts:
    """One cycle. Of ``before``, the earlier cycle's handover, only the named feedbacks enter the plan.

    ``now`` is the time it is, where the cycle is live; without it the cycle lies in the past and is run whole.
    AwaitingApproval: the plan is made, and the ``desk`` has yet to approve it. CycleUnderWay: it is not over ``now``.
    """
    people = desk or NobodyDecides()
    end = cutoff + timedelta(hours=settings.cycle_hours)
    given = taken(before, feedback)
    steps: dict[str, Mapping[str, Any]] = {}
    steps.update(prioritise(runner, case, cutoff, given, feedback, settings))
    steps.update(decide(runner, people, cycle_label(cutoff), steps))
    steps.update(plan(runner, case, cutoff, given, steps, settings, people))
    if now is not None and now < end:
        raise CycleUnderWay(cycle_label(cutoff), end)
    steps.update(observe(runner, case, before, steps, settings))
    steps.update(understand(runner, case, end, before, steps, settings))
    return CycleProducts(cycle_label(cutoff), cutoff, end, steps, handover(before, steps, settings))


def taken(before: Handover, feedback: frozenset[str]) -> Handover:
    """The part of a handover that the chosen feedbacks let through to the next plan.

    The old schedule always passes: its commands are on board and run until the uplink, whether one minds them or not.
    """
    return Handover(
        soil_moisture=before.soil_moisture if "soil-moisture" in feedback else (),
        burned_area=before.burned_area,
        fire_arrival=before.fire_arrival if "arrival" in feedback else (),
        observed=before.observed if "observed" in feedback else None,
        ratings=before.ratings,
        targets_report=before.targets_report,
        schedule=before.schedule,
        spacecraft=before.spacecraft if "spacecraft" in feedback else None,
    )


def handover(before: Handover, steps: Mapping[str, Mapping[str, Any]], settings: LoopSettings) -> Handover:
    """What the next cycle may start from: products of delivered data and ``as_run``, never the plan's intentions."""
    remembered = -(-SOIL_MEMORY_H // settings.cycle_hours)
    return Handover(
        soil_moisture=(*before.soil_moisture, steps["retrieve-soil-moisture"]["soil_moisture"])[-remembered:],
        burned_area=(*before.burned_area, steps["retrieve-burned-area"]["burned_area"]),
        fire_arrival=tuple(steps["infer-fire-arrival"]["fire_arrival"]),
        observed=steps["observed-places"]["observed"],
        ratings=steps["rate-active-fires"]["ratings"],
        targets_report=steps["build-targets"]["report"],
        schedule=steps["plan-observations"]["schedule"],
        as_run=steps["execute"]["as_run"],
        spacecraft=steps["execute"]["spacecraft"],
        pending_points=steps["execute"]["pending_points"],
    )
