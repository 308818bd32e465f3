"""What a plan is worth and why: totals, latency, resources, and a reason for every active target left out."""

from __future__ import annotations

from typing import Any

import numpy as np

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.planner import Plan
from services.planning.problem import IntArray, PlanningProblem
from services.planning.timeline import battery_wh, collected_seconds, stored_images


def plan_report(problem: PlanningProblem, plan: Plan, baseline: IntArray) -> dict[str, Any]:
    """The report document: objective, proven bound and gap; targets and rewards; latency; reasons; greedy baseline."""
    observed = problem.covered_targets(plan.timeline.images)
    greedy = problem.objective(baseline)
    return {
        "objective": plan.objective, "bound": plan.bound, "gap": plan.gap, "method": plan.method,
        "time_limited": plan.time_limited, "model": plan.model_size,
        "active_mandatory": {"held": plan.mandatory, "possible": plan.mandatory_possible},
        "targets": _targets(problem, observed), "images_planned": len(plan.timeline.images),
        "latency": _latency(problem, plan.timeline), "satellites": _satellites(problem, plan.timeline),
        "active_targets_not_observed": unmet_active(problem, plan.timeline),
        "greedy_baseline": {
            "objective": greedy, "images": len(baseline),
            "gap": max(0.0, 1 - greedy / plan.bound) if plan.bound else 0.0,
            "targets": _targets(problem, problem.covered_targets(baseline)),
        },
        "previous_plan": {
            "collects_kept": len(problem.frozen.second), "downlink_s_kept": int((problem.frozen.downlink >= 0).sum()),
            "command_s_that_cannot_run": problem.frozen.dropped,
        },
    }  # fmt: skip


def _targets(problem: PlanningProblem, observed: np.ndarray) -> dict[str, Any]:
    result = {}
    for kind, mask in (("active", problem.targets.active), ("prefire", ~problem.targets.active)):
        reachable = mask & (problem.opportunity_count > 0)
        result[kind] = {
            "planned": int((mask & observed).sum()), "available": int(reachable.sum()), "total": int(mask.sum()),
            "reward_planned": float(problem.targets.value[mask & observed].sum()),
            "reward_available": float(problem.targets.value[reachable].sum()),
        }  # fmt: skip
    return result


def downlink_times(problem: PlanningProblem, timeline: Timeline, satellite: int) -> tuple[IntArray, IntArray]:
    """Second of collection and of the end of downlink (-1: still on board) of each image, first in first out."""
    limits = problem.satellites[satellite]
    taken = np.flatnonzero(collected_seconds(problem, timeline.images)[satellite])
    seconds = np.flatnonzero(timeline.downlink[satellite] >= 0) + 1
    last = limits.downlink_s_per_image * (limits.stored_images_initial + 1 + np.arange(len(taken))) - 1
    done = np.full(len(taken), -1, np.int64)
    done[last < len(seconds)] = seconds[last[last < len(seconds)]]
    return taken, done


def _latency(problem: PlanningProblem, timeline: Timeline) -> dict[str, Any]:
    """Hours from collection to the end of downlink."""
    waits, waiting = [], 0
    for satellite in range(len(problem.satellites)):
        taken, done = downlink_times(problem, timeline, satellite)
        waits.append((done - taken)[done >= 0] / 3600.0)
        waiting += int((done < 0).sum())
    hours = np.concatenate(waits) if waits else np.zeros(0)
    stats = {"images_downlinked": len(hours), "images_left_on_board": waiting}
    if len(hours):
        median, high = np.percentile(hours, [50, 95])
        stats |= {"median_h": float(median), "p95_h": float(high), "max_h": float(hours.max())}
    return stats


def _satellites(problem: PlanningProblem, timeline: Timeline) -> dict[str, Any]:
    stored = stored_images(problem, timeline.images, timeline.downlink)
    battery = battery_wh(problem, timeline.images, timeline.downlink)
    collect = collected_seconds(problem, timeline.images)
    result = {}
    for s, limits in enumerate(problem.satellites):
        contact = problem.uplink_contact[s]
        result[limits.name] = {
            "images": int(collect[s].sum()), "downlink_s": int((timeline.downlink[s] >= 0).sum()),
            "stored_max": int(stored[s].max()), "stored_at_end": int(stored[s, -1]),
            "battery_min_wh": float(battery[s].min()), "battery_at_end_wh": float(battery[s, -1]),
            "uplink_contact": contact.isoformat() if contact is not None else None,
            "takes_new_commands": bool(problem.commandable[s].any()),
        }  # fmt: skip
    return result


def unmet_active(problem: PlanningProblem, timeline: Timeline) -> list[dict[str, Any]]:
    """Each active target left out, with the reason: no opportunity, out of commands' reach, or crowded out by what."""
    observed = problem.covered_targets(timeline.images)
    stored = stored_images(problem, timeline.images, timeline.downlink)
    battery = battery_wh(problem, timeline.images, timeline.downlink)
    image_of = problem.images.image_of_entry()
    order = np.argsort(problem.images.target, kind="stable")
    bounds = np.searchsorted(problem.images.target[order], np.arange(len(observed) + 1))
    unmet = []
    for target in np.flatnonzero(problem.targets.active & ~observed):
        images = image_of[order[bounds[target] : bounds[target + 1]]]
        if problem.opportunity_count[target] == 0:
            reason = "no opportunity"
        elif not len(images):
            reason = "no opportunity that a command can reach (uplink, unavailable satellite or earlier plan)"
        else:
            causes = sorted({_cause(problem, timeline, stored, battery, int(image)) for image in images})
            reason = "crowded out: " + "; ".join(causes[:3])
        unmet.append({
            "target_id": int(problem.targets.target_id[target]), "reward": float(problem.targets.value[target]),
            "opportunities": int(problem.opportunity_count[target]), "reason": reason,
        })  # fmt: skip
    return unmet


def _cause(problem: PlanningProblem, timeline: Timeline, stored: IntArray, battery: np.ndarray, image: int) -> str:
    s, second = int(problem.images.satellite[image]), int(problem.images.second[image])
    limits = problem.satellites[s]
    full = np.flatnonzero(stored[s, second:] >= limits.storage_images)
    low = np.flatnonzero(battery[s, second:] - limits.collect_w / 3600.0 < limits.battery_min_wh)
    ends = cycle_ends(problem, s)
    if timeline.downlink[s, second] >= 0:
        return f"downlink of {limits.name} in cycle {np.searchsorted(ends, second, side='right')}"
    if len(full) and (not len(low) or full[0] <= low[0]):
        return f"storage of {limits.name} in cycle {np.searchsorted(ends, second + full[0], side='right')}"
    if len(low):
        return f"battery of {limits.name} in cycle {np.searchsorted(ends, second + low[0], side='right')}"
    return f"other targets of higher reward on {limits.name}"
