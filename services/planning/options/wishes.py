"""What a person decided about targets, and what the previous plan promised, as changes to rewards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from services.planning.options.rules import ACTIONS, OperationRules
from services.planning.problem import Images, IntArray, PlanningProblem, Targets
from shared.errors import DomainError


def changed_tables(tables: dict[str, pd.DataFrame], rules: OperationRules) -> dict[str, pd.DataFrame]:
    """The tables with excluded targets taken out and re-weighted ones given their new reward.

    Raises `DomainError` for an unknown target or action, a target changed twice in one way, or a reward that is none.
    """
    if not rules.target_changes:
        return tables
    _check_changes(set(tables["targets"]["target_id"].astype(int)), rules)
    out = {c.target_id for c in rules.target_changes if c.action == "exclude"}
    new = {c.target_id: c.priority for c in rules.target_changes if c.action == "reweight"}
    targets = tables["targets"][~tables["targets"]["target_id"].isin(out)].copy()
    targets["priority"] = targets["target_id"].map(new).fillna(targets["priority"]).astype(float)
    seen_of = tables["opportunities"]
    return {**tables, "targets": targets, "opportunities": seen_of[~seen_of["target_id"].isin(out)]}


def _check_changes(known: set[int], rules: OperationRules) -> None:
    actions: dict[int, list[str]] = {}
    for place, change in enumerate(rules.target_changes):
        field = f"target_changes[{place}]"
        if change.action not in ACTIONS:
            accepted = "|".join(ACTIONS)
            raise DomainError("unknown action", field=f"{field}.action", value=change.action, accepted=accepted)
        if change.target_id not in known:
            raise DomainError(
                "a change names a target that the targets table lacks", field=f"{field}.target_id",
                value=change.target_id, accepted="ids of the targets table",
            )  # fmt: skip
        if change.action == "reweight" and not (change.priority is not None and 0 <= change.priority < np.inf):
            raise DomainError(
                "a re-weighted target needs a reward", field=f"{field}.priority", value=change.priority,
                accepted="finite, >= 0",
            )  # fmt: skip
        own = actions.setdefault(change.target_id, [])
        if change.action in own or (own and "exclude" in (change.action, *own)):
            raise DomainError(
                f"changes of target {change.target_id} contradict each other", field=field,
                value=" and ".join([*own, change.action]),
                accepted="one exclude, or one pin and one reweight, a target",
            )  # fmt: skip
        own.append(change.action)


def pin(targets: Targets, rules: OperationRules) -> Targets:
    """Targets with the pinned ones marked."""
    pins = [c.target_id for c in rules.target_changes if c.action == "pin"]
    return replace(targets, pinned=np.isin(targets.target_id, pins)) if pins else targets


def keepable_images(problem: PlanningProblem, previous: pd.DataFrame | None, first_s: IntArray) -> IntArray:
    """Images that the previous plan meant to collect, are not yet beyond recall, and can still be collected."""
    if previous is None or not len(previous):
        return np.zeros(0, np.int64)
    names = {limits.name: row for row, limits in enumerate(problem.satellites)}
    rows = previous[(previous["command"] == "collect") & previous["satellite"].astype(str).isin(names)]
    satellite = rows["satellite"].astype(str).map(names).to_numpy(np.int64)
    second = np.rint((rows["start"] - problem.horizon_start) / pd.Timedelta(seconds=1)).to_numpy(np.int64)
    later = (second >= first_s[satellite]) & (second < problem.horizon_s)
    wanted = np.unique(satellite[later] * problem.horizon_s + second[later])
    places = problem.images.satellite * problem.horizon_s + problem.images.second
    kept = np.flatnonzero(np.isin(places, wanted))
    kept = kept[~np.isin(kept, problem.frozen_images)]
    _, first = np.unique(places[kept], return_index=True)
    return kept[np.sort(first)]


def with_change_penalty(problem: PlanningProblem, kept: IntArray, penalty: float) -> PlanningProblem:
    """The problem in which each image of ``kept`` earns ``penalty`` by itself: what dropping it would cost.

    The earnings are targets of their own (ids below zero), so that no reduction mistakes one image for another.
    """
    if penalty <= 0 or not len(kept):
        return problem
    targets, images = problem.targets, problem.images
    count = len(kept)
    lowest = min(0, int(targets.target_id.min(initial=0)))
    more = Targets(
        np.concatenate([targets.target_id, lowest - 1 - np.arange(count)]),
        np.concatenate([targets.active, np.zeros(count, bool)]),
        np.concatenate([targets.value, np.full(count, penalty)]),
        None if targets.pinned is None else np.concatenate([targets.pinned, np.zeros(count, bool)]),
    )
    at = images.start[kept + 1]
    covered = np.insert(images.target, at, len(targets.value) + np.arange(count))
    sizes = np.diff(images.start)
    sizes[kept] += 1
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    grown: Images = replace(images, start=start, target=covered.astype(np.int64))
    seen = np.concatenate([problem.opportunity_count, np.ones(count, np.int64)])
    return replace(problem, targets=more, images=grown, opportunity_count=seen)
