"""What each option costs in reward, and what the mandatory constraint does: by planning again without it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from services.planning.options.rules import OperationRules
from services.planning.planner import Progress, plan
from services.planning.problem import ACTIVE_WEIGHT, BoolArray
from services.planning.request import Answer, Request, sequenced, solve
from services.planning.sequencing.recorded import recorded
from services.planning.sequencing.sequence import SEARCH_ALONE

COUNT_FIRST = "under these rules the search puts the number of active targets first, and has no plan free of that"
QUIET: Progress = lambda percent, text: None  # noqa: E731


def reward_of(answer: Answer, request: Request) -> float:
    """Equation 1 of a plan under the rewards as they were given, whatever a person changed later."""
    targets, seen = request.tables["targets"], request.tables["opportunities"]
    images = answer.problem.images.image_id[answer.plan.timeline.images]
    observed = set(seen.loc[seen["image_id"].isin(images), "target_id"].tolist())
    mask = targets["target_id"].isin(observed).to_numpy()
    weight = np.where(targets["kind"].astype(str) == "active", ACTIVE_WEIGHT, 1.0)
    return float((weight * targets["priority"].to_numpy(float))[mask].sum())


def price_options(request: Request, answer: Answer, progress: Progress) -> list[dict[str, Any]]:
    """For every option in force: the reward of the plan without it, all else alike, and so what it costs."""
    prices = []
    cases = list(_without_each(request))
    for place, (name, value, freed) in enumerate(cases):
        progress(86 + 4 * place / len(cases), f"price of {name}")
        other = solve(freed, QUIET)
        if name == "target_changes":
            held, free = (reward_of(item, request) for item in (answer, other))
        else:
            held, free = answer.reward, max(answer.reward, other.reward)
        prices.append({
            "option": name, "value": value, "reward_with": held, "reward_without": free, "cost": free - held,
            "bound_without": other.plan.bound,
        })  # fmt: skip
    return prices


def _without_each(request: Request) -> Iterator[tuple[str, Any, Request]]:
    """(name, value, the request without it) for every option in force."""
    rules, off = request.rules, OperationRules()
    simple = ("min_collect_s", "mode_switch_s", "max_commands_per_day", "acquisition_s", "nominal_share",
              "change_penalty", "fragile_discount")  # fmt: skip
    for name in simple:
        if getattr(rules, name) != getattr(off, name):
            yield name, getattr(rules, name), replace(request, rules=replace(rules, **{name: getattr(off, name)}))
    if rules.booked is not None:
        yield "booked_passes", len(rules.booked), replace(request, rules=replace(rules, booked=None))
    if rules.target_changes:
        yield "target_changes", len(rules.target_changes), replace(request, rules=replace(rules, target_changes=()))
    windows = sum(len(state.unavailable) for state in request.spacecraft.satellites.values())
    if windows or rules.outages:
        states = {
            name: state.model_copy(update={"unavailable": ()}) for name, state in request.spacecraft.satellites.items()
        }
        freed = request.spacecraft.model_copy(update={"satellites": states})
        value = windows + len(rules.outages)
        yield "unavailable", value, replace(request, spacecraft=freed, rules=replace(rules, outages=()))


def price_mandatory(answer: Answer, request: Request) -> tuple[dict[str, Any] | None, str | None]:
    """Where the active targets cannot all be met: the plan that keeps as many as can be, against the one that is free;
    or None and the reason why that is not known.

    Both are None where all that can be reached are observed anyway, or where nothing was demanded.
    """
    problem, made = answer.problem, answer.plan
    active = problem.targets.active
    reachable = problem.covered_targets(np.arange(len(problem.images))) & active
    observed = problem.covered_targets(made.timeline.images) & active
    if made.mandatory or request.options.active_mandatory == "false" or not (reachable & ~observed).any():
        return None, None
    if made.method == SEARCH_ALONE:
        return None, COUNT_FIRST
    if made.mandatory_most is not None and _met(answer) >= made.mandatory_most:
        return _dropping(answer, observed, observed, answer.reward), None  # as many as can be: nothing was dropped
    bonus = 1.0 + float(problem.targets.value.sum())
    favoured = replace(problem, targets=replace(problem.targets, value=problem.targets.value + bonus * active))
    options = replace(request.options, active_mandatory="false", mip_gap=1e-9)
    if sequenced(problem, request.rules):
        grown, most, _ = recorded(favoured, request.rules, options, QUIET)
    else:
        grown, most = favoured, plan(favoured, options, QUIET)
    met = grown.covered_targets(most.timeline.images)
    held, kept = met & active, float(problem.targets.value[met].sum())
    if held.sum() < observed.sum():
        return None, "the search for it ended with fewer active targets than the plan observes"
    return _dropping(answer, observed, held, kept), None


def _met(answer: Answer) -> int:
    """Mandatory targets that the plan observes, active or pinned."""
    targets = answer.problem.targets
    wanted = targets.active | targets.demanded()
    return int((answer.problem.covered_targets(answer.plan.timeline.images) & wanted).sum())


def _dropping(answer: Answer, observed: BoolArray, held: BoolArray, kept: float) -> dict[str, Any]:
    """The plan against one that observes the active targets ``held``, as many as can be, and is worth ``kept``."""
    return {
        "active_observed": int(observed.sum()), "active_observed_at_most": int(held.sum()),
        "reward": answer.reward, "reward_with_most_active": kept,
        "reward_gained_by_dropping": answer.reward - kept,
        "active_lost_by_dropping": int(held.sum()) - int(observed.sum()),
    }  # fmt: skip
