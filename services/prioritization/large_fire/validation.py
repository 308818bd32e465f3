"""Fires predicted by models that have not seen them: rolling origin by season, or one region left out at a time.

Each fold carries margins for its own fires and, for calibration and thresholds, margins of its training fires from
models that have not seen those either. Nothing of a fold's fires, nor of later seasons, enters what predicts them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization import plain_columns
from services.prioritization.large_fire import features, model
from services.prioritization.large_fire.model import TREE_SHARE
from shared.errors import DomainError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Design = Literal["rolling-origin", "leave-one-out"]
HALVES = ("trees", "logistic", "model")

FIRST_SCORED_SEASONS = 3


@dataclass(frozen=True)
class Fold:
    """One season or region: its fires, the fires that may teach, and margins (n, 3) of trees, regression and blend.

    ``margin`` holds the fold's own fires, ``taught`` the teaching fires by models unseen to them; NaN elsewhere.
    """

    name: str
    now: Mask
    earlier: Mask
    margin: Array
    taught: Array


@dataclass(frozen=True)
class Table:
    """Fires ready for training: features, outcome, season or region, and how many rows had no weather."""

    frame: pd.DataFrame
    outcome: Array
    unit: npt.NDArray[np.str_]
    without_weather: int


def checked(
    table: pd.DataFrame, label: str, unit: str, schema: features.Schema, design: Design = "rolling-origin"
) -> Table:
    """Rows with label, season (or region) and weather; DomainError where column or content cannot do."""
    for field, name in (("label", label), ("season_column", unit)):
        if name not in table.columns:
            raise DomainError(f"The table has no column '{name}'.", field=field, value=name, accepted="a column's name")
    missing = [f.name for f in features.features_of(schema) if f.name not in table.columns]
    if missing:
        raise DomainError(
            f"The table lacks the column '{missing[0]}' of the '{schema}' columns.",
            field=missing[0],
            accepted=", ".join(f.name for f in features.features_of(schema)),
        )
    labelled = table[table[label].notna() & table[unit].notna()]
    needed = [model.START_INDEX[schema], "temperature_c", "relative_humidity_pct", "wind_speed_m_s"]
    kept = labelled[labelled[needed].notna().all(axis=1)].reset_index(drop=True)
    wettest = float(kept["relative_humidity_pct"].max()) if len(kept) else 100.0
    if wettest <= 1:
        raise DomainError(
            f"'relative_humidity_pct' never exceeds {wettest:g}; it is probably a fraction.",
            field="relative_humidity_pct",
            value=wettest,
            accepted="0..100 %",
        )
    y = plain_columns.numbers(kept, label, "label")
    if not np.isin(y, (0, 1)).all():
        raise DomainError(f"Column '{label}' holds more than 0 and 1.", field="label", value=label, accepted="0 or 1")
    units = kept[unit].astype(str).to_numpy()
    fewest = FIRST_SCORED_SEASONS + 2 if design == "rolling-origin" else 3
    if len(set(units)) < fewest or not 10 <= y.sum() <= len(y) - 10:
        raise DomainError(
            f"{len(set(units))} seasons or regions with {int(y.sum())} large of {len(y)} fires are too few to "
            "calibrate on unseen ones.",
            field="table",
            accepted=f"{fewest} or more seasons (or 3 regions), 10 or more fires of each kind",
        )
    return Table(kept, y, units, len(labelled) - len(kept))


def _halves(
    table: Table, teach: Mask, of: Mask, schema: features.Schema, seed: int, groups: tuple[features.Group, ...]
) -> Array:
    """Margins (n, 3) of the fires ``of`` by halves taught by ``teach``; NaN elsewhere."""
    out = np.full((len(table.outcome), 3), np.nan)
    if len(set(table.outcome[teach])) == 2 and of.any():
        parts = model.fit_parts(table.frame[teach], table.outcome[teach], schema, seed, groups)
        trees, line = parts.halves(table.frame[of])
        out[of] = np.stack([trees, line, TREE_SHARE * trees + (1 - TREE_SHARE) * line], axis=1)
    return out


def folds(
    table: Table,
    schema: features.Schema,
    design: Design = "rolling-origin",
    seed: int = 0,
    groups: tuple[features.Group, ...] = features.GROUPS,
) -> list[Fold]:
    """Every season from the fourth on (or every region) as a fold."""
    if design == "rolling-origin":
        return _rolling(table, schema, seed, groups)
    return _left_out(table, schema, seed, groups)


def _rolling(table: Table, schema: features.Schema, seed: int, groups: tuple[features.Group, ...]) -> list[Fold]:
    seasons = sorted(set(table.unit))
    margins = np.full((len(table.outcome), 3), np.nan)
    made = []
    for name in seasons[FIRST_SCORED_SEASONS:]:
        now, earlier = table.unit == name, table.unit < name
        taught = np.where(earlier[:, None], margins, np.nan)
        own = _halves(table, earlier, now, schema, seed, groups)
        margins[now] = own[now]
        made.append(Fold(name, now, earlier, own, taught))
    return made


def _left_out(table: Table, schema: features.Schema, seed: int, groups: tuple[features.Group, ...]) -> list[Fold]:
    regions = sorted(set(table.unit))
    made = []
    for name in regions:
        now = table.unit == name
        taught = np.full((len(table.outcome), 3), np.nan)
        for other in regions:
            inner = (table.unit == other) & ~now
            taught[inner] = _halves(table, ~now & ~inner, inner, schema, seed, groups)[inner]
        own = _halves(table, ~now, now, schema, seed, groups)
        made.append(Fold(name, now, ~now, own, taught))
    return made


def unseen_margins(made: list[Fold]) -> Array:
    """The blend's margin of each fire by the model of its own fold, (n,); NaN in seasons that have no fold."""
    out = np.full(len(made[0].now), np.nan)
    for fold in made:
        out[fold.now] = fold.margin[fold.now, HALVES.index("model")]
    return out
