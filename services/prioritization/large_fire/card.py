"""The model card: what the large-fire model is, what it was trained on, how well it did on unseen fires."""

from __future__ import annotations

from typing import Any

from services.prioritization.large_fire import features
from services.prioritization.large_fire.evaluation import PREVALENCES
from services.prioritization.large_fire.model import PARAMETERS, ROUNDS, TREES_PER_ROUND, Calibration

METRICS = ("mcc", "auc", "precision", "recall", "brier", "calibration_error")
NAMES = {"model": "**model**", "trees": "trees alone", "logistic": "regression alone"}


def _cell(row: dict[str, Any], metric: str) -> str:
    interval = row.get(f"{metric}_interval")
    spread = f" [{interval[0]:.3f}, {interval[1]:.3f}]" if interval else ""
    return f"{row[metric]:.3f}{spread}"


def skill_table(rows: dict[str, dict[str, Any]]) -> str:
    """Markdown: a row a competitor, the three models first, then single indices by falling MCC."""
    models = [name for name in NAMES if name in rows]
    singles = sorted((name for name in rows if name not in NAMES), key=lambda name: -rows[name]["mcc"])
    lines = ["| | MCC | AUC | precision | recall | Brier | calibration error |", "|---|---|---|---|---|---|---|"]
    for name in [*models, *singles]:
        label = NAMES.get(name) or features.BY_NAME[name].label
        lines.append(f"| {label} | " + " | ".join(_cell(rows[name], metric) for metric in METRICS) + " |")
    return "\n".join(lines)


def reliability_table(skill: dict[str, Any]) -> str:
    """Markdown: forecast and observed frequency by tenth of the forecast."""
    lines = ["| fires | forecast | observed |", "|---|---|---|"]
    lines += [f"| {b['count']:.0f} | {b['forecast']:.3f} | {b['observed']:.3f} |" for b in skill["reliability"]]
    return "\n".join(lines)


def ablation_table(rows: list[dict[str, Any]]) -> str:
    """Markdown: skill as feature groups are added, by learner."""
    lines = ["| columns | learner | AUC | MCC | Brier skill |", "|---|---|---|---|---|"]
    lines += [
        f"| {row['columns']} | {NAMES[row['learner']].strip('*')} | {row['auc']:.3f} | {row['mcc']:.3f} | "
        f"{row['brier_skill']:.3f} |"
        for row in rows
    ]
    return "\n".join(lines)


def write(calibration: Calibration, skill: dict[str, Any], source: str) -> str:
    """Markdown from a calibration and the result of ``evaluation.evaluate``; every number is a measured one."""
    best = skill["best_index_by_mcc"]
    verdict = "ranks fires better than" if skill["auc"] > skill["natural"][best]["auc"] else "does not rank above"
    names = ", ".join(f"`{name}`" for name in calibration.median)
    parameters = ", ".join(f"{key} {value}" for key, value in sorted(PARAMETERS[calibration.schema].items()))
    tables = "\n\n".join(f"At {name} prevalence:\n\n{skill_table(skill[name])}" for name in PREVALENCES)
    top, times = skill["top_decile"], skill["mcc_over_best_index"]
    ratio = f"{times:.2f} times its MCC" if times else "whose MCC is not above 0"
    return f"""# Large-fire model ({calibration.schema} columns)

Probability that an active fire grows past the label `{calibration.label}`. The mean of two log odds: gradient-boosted
trees (XGBoost, {ROUNDS[calibration.schema]} rounds of {TREES_PER_ROUND} trees, {parameters}; monotone where physics
fixes the sign) that start from a logistic regression on one index, and a ridge logistic regression on
{len(calibration.linear.terms)} terms under the same signs. Platt calibration on fires unseen by their model; interval
from refitting the calibration to resampled seasons. No reweighting.

**Columns:** {names}.

**Trained on:** {source}; {calibration.fires} fires, {calibration.large_fires} large
({100 * calibration.base_rate:.1f} %), {calibration.seasons[0]} to {calibration.seasons[-1]}.

**Measured** on {", ".join(skill["units"])}: each predicted by a model of other fires only (of earlier ones where they
are seasons), threshold and calibration too, pooled: {skill["fires"]} fires, {skill["large_fires"]} large. Brackets: 5
and 95 % by resampling whole seasons or regions.

{tables}

The model {verdict} the best single index, `{best}`: {ratio}. Brier skill
over the base rate {skill["brier_skill"]:.3f}, calibration slope {skill["calibration_slope"]:.2f}. Of the tenth of fires
with the highest forecasts {100 * top["forecast"]:.1f} % were expected to become large, {100 * top["observed"]:.1f} %
did:

{reliability_table(skill)}

**Percentile:** among training fires of the same stage of the season (thirds of KBDI) and height of the place (below 200
m, to 600 m, above): {", ".join(f"{name} {count}" for name, count in calibration.groups.fires.items())} fires.

**Limits.** Trained on fires of one table; elsewhere it is an extrapolation, and a rating whose inputs leave the
training fires' range says so (`out_of_domain`). Weather of a training fire is that of the hour it was reported; a
rating uses the worst hour of the coming day. The table keeps no dates, so there is no month and no index that needs
yesterday's. 10-h fuel moisture is 1.28 x equilibrium moisture in training; a forecast takes its place when given.
"""
