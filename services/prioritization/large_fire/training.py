"""Train and test in one go: a model of every fire, and its skill on fires unseen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pandas as pd

from services.prioritization.large_fire import evaluation, features, model, validation
from shared.errors import DomainError

FEWEST_SCORED = 5


@dataclass(frozen=True)
class Trained:
    """A model of all fires of a table and the report of its test (see ``evaluation.evaluate``)."""

    model: model.LargeFireModel
    skill: dict[str, Any]


def train_and_test(
    table: pd.DataFrame,
    label: str,
    unit: str,
    schema: features.Schema = "loop",
    *,
    design: validation.Design = "rolling-origin",
    first_season: str = "",
    ablation: bool = False,
    seed: int = 0,
    resamples: int = evaluation.RESAMPLES,
    progress: Callable[[float, str], None] = lambda percent, message: None,
) -> Trained:
    """Fold by fold, the test on folds from ``first_season`` on (all regions where one is left out), then all fires.

    DomainError for a table that cannot do (see ``validation.checked``) or a first season that leaves no test.
    """
    fires = validation.checked(table, label, unit, schema, design)
    folds = validation.folds(fires, schema, design, seed)
    tested = _tested(folds, design, first_season)
    _check_outcomes(fires, folds, "table", "in the seasons or regions that can be scored")
    _check_outcomes(fires, tested, "first_test_season", f"in the test from '{first_season}' on", fewest=1)
    progress(35, "seasons or regions predicted")
    report = evaluation.evaluate(fires, tested, schema, seed, resamples)
    report["schema"] = schema
    report["validation"] = design
    report["not_carried"] = features.NOT_CARRIED
    progress(60, "tested")
    if ablation:
        report["ablation"] = evaluation.ablation(
            fires,
            lambda groups: _tested(validation.folds(fires, schema, design, seed, groups), design, first_season),
        )
    progress(90, "trained")
    unseen = validation.unseen_margins(folds)
    return Trained(model.train(fires.frame, fires.outcome, fires.unit, unseen, schema, label, seed), report)


def _tested(folds: list[validation.Fold], design: validation.Design, first_season: str) -> list[validation.Fold]:
    """Folds to report on: from the first season on, each with earlier folds to calibrate on."""
    chosen = [fold for fold in folds if design == "leave-one-out" or fold.name >= first_season]
    usable = [fold for fold in chosen if pd.notna(fold.taught).any()]
    if not usable:
        raise DomainError(
            f"No season from '{first_season}' on has scored seasons before it to calibrate on.",
            field="first_test_season",
            value=first_season,
            accepted=f"a season after {folds[0].name}",
        )
    return usable


def _check_outcomes(
    fires: validation.Table, folds: list[validation.Fold], field: str, where: str, fewest: int = FEWEST_SCORED
) -> None:
    """DomainError unless the folds hold enough fires of each kind to calibrate on, or to test."""
    scored = pd.concat([pd.Series(fires.outcome[fold.now]) for fold in folds])
    large = int(scored.sum())
    if not fewest <= large <= len(scored) - fewest:
        raise DomainError(
            f"There are {large} large of {len(scored)} fires {where}.",
            field=field,
            value=large,
            accepted=f"{fewest} or more of each kind",
        )
