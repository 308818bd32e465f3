"""What the collected images are worth under a person's changes, which pins are missed, what of the old plan is lost."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pandas as pd

from services.planning.check.commands import Previous
from services.planning.check.reading import Image, Row
from services.planning.check.verdict import ViolationLog
from services.planning.options.rules import OperationRules

ACTIVE_FACTOR = 10.0


def reward(images: set[int], opportunities: pd.DataFrame, targets: pd.DataFrame, rules: OperationRules) -> float:
    """Equation 1: each observed target once, active ones tenfold, with excluded and re-weighted targets."""
    observed = set(opportunities.loc[opportunities["image_id"].isin(images), "target_id"].tolist())
    return worth_of(observed, targets, rules)


def worth_of(observed: set[int], targets: pd.DataFrame, rules: OperationRules) -> float:
    """Equation 1 of a set of observed targets."""
    changed = {c.target_id: c for c in rules.target_changes if c.action != "pin"}
    total = 0.0
    for target, kind, priority in zip(targets["target_id"], targets["kind"], targets["priority"], strict=True):
        if target not in observed:
            continue
        change = changed.get(int(target))
        if change is not None:
            priority = 0.0 if change.action == "exclude" else change.priority
        total += (ACTIVE_FACTOR if str(kind) == "active" else 1.0) * float(priority)
    return total


def fragile_targets(images: set[int], opportunities: pd.DataFrame) -> set[int]:
    """Targets that ``images`` observe, but with no look that is covered both ahead of and behind its prediction."""
    looks = opportunities[opportunities["image_id"].isin(images)]
    robust = pd.Series(True, looks.index)
    for name in ("covered_ahead", "covered_behind"):
        robust &= looks[name].eq(True).fillna(False).astype(bool) if name in looks else False
    return set(looks["target_id"].tolist()) - set(looks.loc[robust, "target_id"].tolist())


def check_pins(
    collected: set[int], opportunities: pd.DataFrame, images: Mapping[int, Image], reachable: set[int],
    rules: OperationRules, log: ViolationLog,
) -> None:  # fmt: skip
    """A pinned target that new commands could reach must be observed."""
    pins = {c.target_id for c in rules.target_changes if c.action == "pin"}
    if not pins:
        return
    rows = opportunities[opportunities["target_id"].isin(pins)]
    for target, group in rows.groupby("target_id")["image_id"]:
        ids = set(group.astype(int))
        could = sorted(ids & reachable, key=lambda i: (images[i].second, images[i].satellite))
        if could and not ids & collected:
            first = images[could[0]]
            detail = f"pinned target {target} is not observed, though image {could[0]} sees it"
            log.add("pinned", first.satellite, int(first.second), detail)


def reachable_images(
    images: Mapping[int, Image], first: Mapping[str, float],
    closed: Mapping[str, list[tuple[str, tuple[float, float]]]], frozen: set[tuple[str, int]], horizon_s: int,
) -> set[int]:  # fmt: skip
    """Images that a new command could collect: after the uplink, in service, and not where an old command runs."""
    found = set()
    for number, image in images.items():
        name, second = image.satellite, image.second
        if name not in first or not 0 <= second < horizon_s or second < first[name]:
            continue
        away = any(math.floor(begin) <= second < end for _, (begin, end) in closed[name])
        if not away and (name, int(second)) not in frozen:
            found.add(number)
    return found


def images_that_see(opportunities: pd.DataFrame, rules: OperationRules) -> set[int]:
    """Images with a target that nobody excluded."""
    excluded = [c.target_id for c in rules.target_changes if c.action == "exclude"]
    return set(opportunities.loc[~opportunities["target_id"].isin(excluded), "image_id"].unique().tolist())


def dropped_images(
    commands: Mapping[str, Mapping[int, Row]], images: Mapping[int, Image], reachable: set[int], kept: Previous,
    first: Mapping[str, float],
) -> int:  # fmt: skip
    """Collects of the previous plan, still to be commanded and still possible, that the schedule gives up."""
    possible = {(images[i].satellite, int(images[i].second)) for i in reachable}
    dropped = 0
    for (name, second), (command, _, begun) in kept.items():
        if command == "collect" and name in first and begun >= first[name] and (name, second) in possible:
            row = commands.get(name, {}).get(second)
            dropped += row is None or row.command != "collect"
    return dropped
