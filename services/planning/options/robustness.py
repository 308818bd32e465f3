"""Looks that a satellite's along-track error may spoil, and a plan that prefers those that it cannot.

Access marks each opportunity that is still covered when the satellite runs ahead of, or behind, its prediction. A
target's reward is split: the discount's share of it is earned only by a look that is covered either way. That is
equation 1 over more targets, so bound and gap stay proven.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from services.planning.problem import BoolArray, IntArray, PlanningProblem, Targets
from shared.errors import DomainError

COLUMNS = ("covered_ahead", "covered_behind")


def robustness_known(opportunities: pd.DataFrame) -> bool:
    """Whether the table says of any opportunity what an error would do to it."""
    return all(name in opportunities and bool(opportunities[name].notna().any()) for name in COLUMNS)


def robust_entries(problem: PlanningProblem, opportunities: pd.DataFrame) -> BoolArray:
    """Per CSR entry of the problem's images: covered ahead and behind alike. What is not known counts as fragile."""
    images, targets = problem.images, problem.targets
    if not robustness_known(opportunities) or not len(targets.target_id):
        return np.zeros(len(images.target), bool)
    sure = np.logical_and.reduce([opportunities[name].astype("boolean").fillna(False).to_numpy(bool)
                                  for name in COLUMNS])  # fmt: skip
    rows = opportunities[sure & opportunities["target_id"].isin(targets.target_id).to_numpy()]
    order = np.argsort(targets.target_id, kind="stable")
    place = order[np.searchsorted(targets.target_id[order], rows["target_id"].to_numpy(np.int64))]
    known = rows["image_id"].to_numpy(np.int64) * len(order) + place
    own = images.image_id[images.image_of_entry()] * len(order) + images.target
    return np.isin(own, known)


def with_fragile_discount(problem: PlanningProblem, opportunities: pd.DataFrame, share: float) -> PlanningProblem:
    """The problem in which ``share`` of every target's reward is a target of its own, seen by robust looks alone.

    Raises `DomainError` where the opportunities do not tell robust looks from fragile ones.
    """
    if share <= 0:
        return problem
    if not robustness_known(opportunities):
        raise DomainError(
            "a discount on fragile looks needs opportunities that tell them from robust ones",
            field="opportunities.covered_ahead", value="absent or empty",
            accepted="covered_ahead and covered_behind, or fragile_discount 0",
        )  # fmt: skip
    targets, images = problem.targets, problem.images
    sure = np.flatnonzero(robust_entries(problem, opportunities))
    doubled, twin = np.unique(images.target[sure], return_inverse=True)
    more = _twins(targets, doubled, share)
    target = np.insert(images.target, sure + 1, len(targets.value) + twin.reshape(-1))
    sizes = np.diff(images.start) + np.bincount(images.image_of_entry()[sure], minlength=len(images))
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    seen = np.concatenate([problem.opportunity_count, np.ones(len(doubled), np.int64)])
    grown = replace(images, start=start, target=target.astype(np.int64))
    return replace(problem, targets=more, images=grown, opportunity_count=seen)


def _twins(targets: Targets, doubled: IntArray, share: float) -> Targets:
    """All targets at what a fragile look earns, then those ``doubled`` at what a robust one adds (ids below zero)."""
    lowest, none = min(0, int(targets.target_id.min(initial=0))), np.zeros(len(doubled), bool)
    return Targets(
        np.concatenate([targets.target_id, lowest - 1 - np.arange(len(doubled))]),
        np.concatenate([targets.active, none]),
        np.concatenate([targets.value * (1.0 - share), targets.value[doubled] * share]),
        np.concatenate([targets.demanded(), none]),
    )


def observed_robustly(problem: PlanningProblem, opportunities: pd.DataFrame, images: IntArray) -> BoolArray:
    """Targets that at least one robust look among ``images`` observes."""
    entry = robust_entries(problem, opportunities) & np.isin(problem.images.image_of_entry(), images)
    mask = np.zeros(len(problem.targets.value), bool)
    mask[problem.images.target[entry]] = True
    return mask
