"""Why a target is not observed: nothing sees it, nothing that can be commanded does, or what crowded it out."""

from __future__ import annotations

from typing import Any

import numpy as np

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.problem import PlanningProblem
from services.planning.timeline import battery_wh, collected_seconds, stored_images

NEVER = "no opportunity"
OUT_OF_REACH = "no opportunity that a command can reach (uplink, satellite out of service or earlier plan)"
NAMED_CAUSES = 3


def target_reasons(problem: PlanningProblem, timeline: Timeline) -> np.ndarray:
    """(targets,) texts: empty where observed, else the reason, with satellite and cycle of what was short."""
    observed = problem.covered_targets(timeline.images)
    reasons = np.full(len(observed), "", object)
    reasons[~observed] = OUT_OF_REACH
    reasons[~observed & (problem.opportunity_count == 0)] = NEVER
    image_of = problem.images.image_of_entry()
    missed = ~observed[problem.images.target]
    if not missed.any():
        return reasons
    texts, cause = np.unique(_causes(problem, timeline), return_inverse=True)
    pairs = np.unique(np.column_stack([problem.images.target[missed], cause.reshape(-1)[image_of[missed]]]), axis=0)
    starts = np.flatnonzero(np.concatenate([[True], pairs[1:, 0] != pairs[:-1, 0]]))
    for rows in np.split(pairs, starts[1:]):
        named = [str(text) for text in texts[rows[:, 1]]]
        more = f"; and {len(named) - NAMED_CAUSES} more" if len(named) > NAMED_CAUSES else ""
        reasons[rows[0, 0]] = "crowded out: " + "; ".join(named[:NAMED_CAUSES]) + more
    return reasons


def unmet_active(problem: PlanningProblem, timeline: Timeline) -> list[dict[str, Any]]:
    """Each active target left out, with its reason."""
    return _unmet(problem, timeline, problem.targets.active)


def unmet_pinned(problem: PlanningProblem, timeline: Timeline) -> list[dict[str, Any]]:
    """Each pinned target left out, with its reason."""
    return _unmet(problem, timeline, problem.targets.demanded())


def _unmet(problem: PlanningProblem, timeline: Timeline, wanted: np.ndarray) -> list[dict[str, Any]]:
    left = np.flatnonzero(wanted & ~problem.covered_targets(timeline.images))
    reasons = target_reasons(problem, timeline) if len(left) else np.zeros(0, object)
    return [
        {
            "target_id": int(problem.targets.target_id[target]), "reward": float(problem.targets.value[target]),
            "opportunities": int(problem.opportunity_count[target]), "reason": str(reasons[target]),
        }
        for target in left
    ]  # fmt: skip


def _causes(problem: PlanningProblem, timeline: Timeline) -> np.ndarray:
    """(images,): what keeps each image from being taken as well, as things stand."""
    own = problem.images
    stored = stored_images(problem, timeline.images, timeline.downlink)
    battery = battery_wh(problem, timeline.images, timeline.downlink)
    collect = collected_seconds(problem, timeline.images)
    causes = np.full(len(own), "", object)
    for s, limits in enumerate(problem.satellites):
        mine = np.flatnonzero(own.satellite == s)
        if not len(mine):
            continue
        second = own.second[mine]
        full = _next(stored[s] >= limits.storage_images)[second]
        low = _next(battery[s] - limits.collect_w / 3600.0 < limits.battery_min_wh)[second]
        ends = cycle_ends(problem, s)
        cycle = {name: np.searchsorted(ends, place, side="right") for name, place in
                 (("storage", full), ("battery", low), ("downlink", second))}  # fmt: skip
        kind = np.where(full <= low, "storage", "battery").astype(object)
        kind[(full >= problem.horizon_s) & (low >= problem.horizon_s)] = "rest"
        kind[timeline.downlink[s, second] >= 0] = "downlink"
        kind[collect[s, second]] = "taken"
        for place, image in enumerate(mine):
            name = str(kind[place])
            if name in cycle:
                causes[image] = f"{name} of {limits.name} in cycle {cycle[name][place]}"
            else:
                causes[image] = _REST[name].format(limits.name)
    return causes


_REST = {
    "taken": "another pointing of {} in the same second",
    "rest": "the order of commands on {}: recordings, switches, slews or what is worth more",
}


def _next(mask: np.ndarray) -> np.ndarray:
    """Of every second, the first at or after it where the mask holds (its length: none)."""
    place = np.where(mask, np.arange(len(mask)), len(mask))
    return np.minimum.accumulate(place[::-1])[::-1]
