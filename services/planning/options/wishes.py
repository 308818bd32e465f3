"""What a person decided about targets, and what the previous plan promised, as changes to rewards."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from services.planning.options.rules import ACTIONS, OperationRules
from services.planning.problem import IntArray, PlanningProblem, Targets
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


@dataclass(frozen=True)
class Keepable:
    """Images that the previous plan meant to collect and that still can be; those of one second share a ``group``."""

    image: IntArray
    group: IntArray

    @property
    def groups(self) -> int:
        """Seconds that the previous plan meant to record."""
        return int(self.group.max(initial=-1)) + 1

    def dropped(self, images: IntArray) -> int:
        """How many of them a plan of ``images`` gives up."""
        return self.groups - len(np.unique(self.group[np.isin(self.image, images)]))


def keepable_images(problem: PlanningProblem, previous: pd.DataFrame | None) -> Keepable:
    """Images of the previous plan that are not yet beyond recall and still possible."""
    none = np.zeros(0, np.int64)
    if previous is None or not len(previous):
        return Keepable(none, none)
    names = {limits.name: row for row, limits in enumerate(problem.satellites)}
    rows = previous[(previous["command"] == "collect") & previous["satellite"].astype(str).isin(names)]
    satellite = rows["satellite"].astype(str).map(names).to_numpy(np.int64)
    second = np.rint((rows["start"] - problem.horizon_start) / pd.Timedelta(seconds=1)).to_numpy(np.int64)
    later = (second >= problem.commands_from()[satellite]) & (second < problem.horizon_s)
    wanted = np.unique(satellite[later] * problem.horizon_s + second[later])
    places = problem.images.satellite * problem.horizon_s + problem.images.second
    image = np.flatnonzero(np.isin(places, wanted))
    image = image[~np.isin(image, problem.frozen_images)]
    _, group = np.unique(places[image], return_inverse=True)
    return Keepable(image, group.reshape(-1).astype(np.int64))


def with_change_penalty(problem: PlanningProblem, keepable: Keepable, penalty: float) -> PlanningProblem:
    """The problem in which each second of ``keepable`` earns ``penalty`` by itself: what dropping it would cost.

    The earnings are targets of their own (ids below zero), so that no reduction mistakes one image for another.
    """
    count = keepable.groups
    if penalty <= 0 or not count:
        return problem
    targets, images = problem.targets, problem.images
    lowest = min(0, int(targets.target_id.min(initial=0)))
    more = Targets(
        np.concatenate([targets.target_id, lowest - 1 - np.arange(count)]),
        np.concatenate([targets.active, np.zeros(count, bool)]),
        np.concatenate([targets.value, np.full(count, penalty)]),
        np.concatenate([targets.demanded(), np.zeros(count, bool)]),
    )
    covered = np.insert(images.target, images.start[keepable.image + 1], len(targets.value) + keepable.group)
    sizes = np.diff(images.start)
    sizes[keepable.image] += 1
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    grown = replace(images, start=start, target=covered.astype(np.int64))
    seen = np.concatenate([problem.opportunity_count, np.ones(count, np.int64)])
    return replace(problem, targets=more, images=grown, opportunity_count=seen)


def without_added_targets(problem: PlanningProblem, plain: PlanningProblem) -> PlanningProblem:
    """``problem`` with the targets of ``plain`` again, its images (which may be more than ``plain``'s) kept."""
    keep = problem.images.target < len(plain.targets.value)
    size = np.bincount(problem.images.image_of_entry()[keep], minlength=len(problem.images))
    start = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    images = replace(problem.images, start=start, target=problem.images.target[keep])
    return replace(problem, images=images, targets=plain.targets, opportunity_count=plain.opportunity_count)
