"""What a plan is worth and why: totals, latency, resources, prices of the options, and reasons for what is left out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from services.planning.data_cycles import cycle_ends
from services.planning.downlinks import Timeline
from services.planning.options.robustness import observed_robustly, robustness_known
from services.planning.options.rules import OperationRules
from services.planning.problem import BoolArray, PlanningProblem
from services.planning.products.changes import change_counts
from services.planning.products.outcomes import downlink_times
from services.planning.products.reasons import target_reasons, unmet_active, unmet_pinned
from services.planning.request import Answer, Request
from services.planning.timeline import battery_wh, collected_seconds, stored_images

LATENCY_LIMIT_H = 24.0
"""The paper expects every image on the ground within a day of its collection (section 4.2)."""


@dataclass(frozen=True)
class Comparison:
    """Targets that the baselines observe, and what options and the mandatory constraint cost (None: not asked, or not
    known for the reason ``unpriced``)."""

    greedy: BoolArray
    manual: BoolArray
    prices: list[dict[str, Any]] | None
    mandatory: dict[str, Any] | None
    unpriced: str | None


def plan_report(request: Request, answer: Answer, comparison: Comparison, changes: pd.DataFrame) -> dict[str, Any]:
    """The report document. Rewards are those of equation 1 (ten times active plus pre-fire)."""
    problem, plan = answer.problem, answer.plan
    observed = problem.covered_targets(plan.timeline.images)
    reasons = target_reasons(problem, plan.timeline)
    return {
        "objective": plan.objective, "bound": plan.bound, "gap": plan.gap, "method": plan.method,
        "bound_of": answer.bound_of, "reward": answer.reward, "time_limited": plan.time_limited,
        "model": plan.model_size,
        "active_mandatory": {
            "asked": request.options.active_mandatory, "held": plan.mandatory, "possible": plan.mandatory_possible,
            "dropping": comparison.mandatory, "dropping_unknown_because": comparison.unpriced,
        },
        "targets": _targets(problem, observed), "images_planned": len(plan.timeline.images),
        "latency": _latency(problem, plan.timeline), "satellites": _satellites(problem, plan.timeline),
        "robustness": _robustness(request, answer, observed),
        "active_targets_not_observed": unmet_active(problem, plan.timeline),
        "pinned_targets_not_observed": unmet_pinned(problem, plan.timeline),
        "targets_not_observed_because": dict(Counter(_kind(str(reason)) for reason in reasons[~observed])),
        "greedy_baseline": _baseline(problem, plan.bound, comparison.greedy),
        "manual_baseline": _baseline(problem, plan.bound, comparison.manual),
        "options": _options(request.rules), "option_prices": comparison.prices,
        "previous_plan": {
            "collects_kept": len(problem.frozen.second), "downlink_s_kept": int((problem.frozen.downlink >= 0).sum()),
            "command_s_that_cannot_run": problem.frozen.dropped, "images_given_up": answer.dropped_images,
            "images_that_could_be_kept": answer.keepable.groups,
            "change_cost": request.rules.change_penalty * answer.dropped_images, "changes": change_counts(changes),
        },
    }  # fmt: skip


def _robustness(request: Request, answer: Answer, observed: BoolArray) -> dict[str, Any] | None:
    """Observed targets with a look that no along-track error spoils, and without (None: nobody worked that out)."""
    opportunities, problem = request.tables["opportunities"], answer.problem
    if not robustness_known(opportunities):
        return None
    robust = observed_robustly(problem, opportunities, answer.plan.timeline.images)
    counts = {
        name: {kind: int((mask & group).sum()) for kind, group in
               (("active", problem.targets.active), ("prefire", ~problem.targets.active))}
        for name, mask in (("observed_robustly", robust), ("observed_only_by_fragile_looks", observed & ~robust))
    }  # fmt: skip
    fragile = float(problem.targets.value[observed & ~robust].sum())
    return {**counts, "reward_of_fragile_looks": fragile, "discount": request.rules.fragile_discount,
            "cost": answer.fragile_cost}  # fmt: skip


def _kind(reason: str) -> str:
    """A reason without satellite and cycle, for counting."""
    if not reason.startswith("crowded out: "):
        return reason
    return "crowded out: " + reason.removeprefix("crowded out: ").split(" of ")[0].split(" on ")[0]


def _baseline(problem: PlanningProblem, bound: float, observed: BoolArray) -> dict[str, Any]:
    """A baseline without the options of sequence (recordings, switches, commands, pointings): a kindness to it."""
    reward = float(problem.targets.value[observed].sum())
    return {
        "objective": reward, "gap": max(0.0, 1 - reward / bound) if bound > 0 else 0.0,
        "targets": _targets(problem, observed),
    }  # fmt: skip


def _options(rules: OperationRules) -> dict[str, Any]:
    """The options in force, with who decided what about targets, when and why."""
    return {
        "min_collect_s": rules.min_collect_s, "mode_switch_s": rules.mode_switch_s,
        "max_commands_per_day": rules.max_commands_per_day, "acquisition_s": rules.acquisition_s,
        "nominal_share": rules.nominal_share, "change_penalty": rules.change_penalty,
        "fragile_discount": rules.fragile_discount,
        "booked_passes": None if rules.booked is None else len(rules.booked),
        "frozen_until": None if rules.frozen_until is None else rules.frozen_until.isoformat(),
        "outages": [_texts(vars(outage)) for outage in rules.outages],
        "target_changes": [_texts(vars(change)) for change in rules.target_changes],
    }  # fmt: skip


def _texts(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value.isoformat() if isinstance(value, pd.Timestamp) else value for name, value in values.items()}


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


def _latency(problem: PlanningProblem, timeline: Timeline) -> dict[str, Any]:
    """Hours from collection to the end of downlink; those of every image are in the images table."""
    waits, waiting, late = [], 0, []
    for s, limits in enumerate(problem.satellites):
        taken, done = downlink_times(problem, timeline, s)
        hours = (done - taken)[done >= 0] / 3600.0
        waits.append(hours)
        waiting += int((done < 0).sum())
        late += [
            {"satellite": limits.name, "second": int(second), "latency_h": float(hour)}
            for second, hour in zip(taken[done >= 0], hours, strict=True)
            if hour > LATENCY_LIMIT_H
        ]
    every = np.concatenate(waits) if waits else np.zeros(0)
    stats: dict[str, Any] = {
        "images_downlinked": len(every), "images_left_on_board": waiting, "limit_h": LATENCY_LIMIT_H,
        "within_limit": not late, "images_over_limit": late,
    }  # fmt: skip
    if len(every):
        median, high = np.percentile(every, [50, 95])
        stats |= {"median_h": float(median), "p95_h": float(high), "max_h": float(every.max())}
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
            "cycles": _cycles(problem, collect[s], timeline.downlink[s] >= 0, s),
            "stored_max": int(stored[s].max()), "stored_at_end": int(stored[s, -1]),
            "battery_min_wh": float(battery[s].min()), "battery_at_end_wh": float(battery[s, -1]),
            "uplink_contact": contact.isoformat() if contact is not None else None,
            "takes_new_commands": bool(problem.commandable[s].any()),
        }  # fmt: skip
    return result


def _cycles(problem: PlanningProblem, collect: np.ndarray, sending: np.ndarray, s: int) -> list[dict[str, int]]:
    """Images and downlink seconds of every data cycle of a satellite; the last may have no pass."""
    bounds = [0, *cycle_ends(problem, s).tolist()]
    if bounds[-1] < problem.horizon_s:
        bounds.append(problem.horizon_s)
    return [
        {
            "cycle": cycle, "start_s": begin, "end_s": end, "images": int(collect[begin:end].sum()),
            "downlink_s": int(sending[begin:end].sum()),
        }
        for cycle, (begin, end) in enumerate(pairwise(bounds))
    ]  # fmt: skip
