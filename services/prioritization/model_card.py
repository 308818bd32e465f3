"""The model card: what the large-fire model is, what it was trained on, how well it did on unseen seasons."""

from __future__ import annotations

from typing import Any

from services.prioritization.large_fire_model import PARAMETERS, ROUNDS, Calibration


def write(calibration: Calibration, skill: dict[str, Any], source: str, first_season: str) -> str:
    """Markdown from a calibration and the result of ``large_fire_skill.evaluate``; every number is a measured one."""
    single = skill["indices"]
    rows = [
        f"| {name} | {values['auc']:.3f} | {values['mcc']:.3f} | | |"
        for name, values in sorted(single.items(), key=lambda item: -item[1]["auc"])
    ]
    bins = [f"| {b['count']} | {b['forecast']:.3f} | {b['observed']:.3f} |" for b in skill["reliability"]]
    best = skill["best_index_by_auc"]
    verdict = "ranks fires better than" if skill["auc"] > single[best]["auc"] else "does not rank fires better than"
    names = ", ".join(f"`{name}`" for name in calibration.median)
    parameters = ", ".join(f"{key} {value}" for key, value in sorted(PARAMETERS[calibration.schema].items()))
    return f"""# Large-fire model ({calibration.schema} columns)

Probability that an active fire grows past the label `{calibration.label}`. A logistic start on log FFDI, then
gradient-boosted trees (XGBoost, {ROUNDS[calibration.schema]} rounds, {parameters}; monotone where physics fixes the
sign), Platt calibration on rolling-origin scores, interval from refitting the calibration to resampled seasons. No
reweighting.

**Columns:** {names}.

**Trained on:** {source}; {calibration.fires} fires, {calibration.large_fires} large
({100 * calibration.base_rate:.1f} %), seasons {calibration.seasons[0]} to {calibration.seasons[-1]}.

**Measured** (rolling origin from {first_season} on, every season predicted by a model of the earlier ones only,
threshold and calibration too, pooled: {skill["fires"]} fires, {skill["large_fires"]} large):

| | AUC | MCC | Brier | Brier skill |
|---|---|---|---|---|
| model | {skill["auc"]:.3f} | {skill["mcc"]:.3f} | {skill["brier"]:.4f} | {skill["brier_skill"]:.3f} |
| base rate | | | {skill["brier_base_rate"]:.4f} | 0 |
{chr(10).join(rows)}

The model {verdict} the best single index, `{best}`; what it adds is a calibrated probability: calibration slope
{skill["calibration_slope"]:.2f}, calibration error {skill["calibration_error"]:.4f}, precision {skill["precision"]:.2f}
and recall {skill["recall"]:.2f} at the threshold of the earlier seasons.

| fires | forecast | observed |
|---|---|---|
{chr(10).join(bins)}

**Limits.** Trained on fires of Victoria, Australia; elsewhere it is an extrapolation, and a rating whose inputs leave
the training fires' range says so (`out_of_domain`). Weather of a training fire is that of the hour it was reported; a
rating uses the worst hour of the coming day. The table keeps no dates, so there is no month and no index that needs
yesterday's. 10-h fuel moisture is 1.28 x equilibrium moisture in training; a forecast takes its place when given.
"""
