"""Make the shipped burned-area model and its card: ``python -m services.retrieval.burned_area.shipped_model``.

No labelled delay-Doppler maps are public, so the model learns from simulated worlds. Worlds are split by region and
time: some train, others calibrate, others again (elsewhere and later) are only scored. Baseline, training and scored
looks have their own tracks, days and noise.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.ancillary.layers import Layers, with_ancillary
from services.retrieval.burned_area.labels import BURNED, UNKNOWN, label_looks, labels_table
from services.retrieval.burned_area.model import FEATURES, BurnedModel, auc, feature_table, train
from services.retrieval.looks.baseline import CHANGE_FEATURES, build_baseline
from services.retrieval.looks.features import TEXTURE_FEATURES, read_observations
from services.retrieval.simulation.observations import simulate_nominal, simulate_raw_if
from services.retrieval.simulation.training_world import (
    DAY_MS,
    WorldPlan,
    make_images,
    make_soil_moisture,
    make_specular_points,
    make_surface,
)

MODEL_PATH = Path(__file__).parents[1] / "models" / "burned_area.ubj"
CARD_PATH = MODEL_PATH.with_suffix(".md")
RAW_IF_SHARE = 0.15  # of the satellite-seconds after the ignitions
UNBURNED_LEAD_DAYS = 3  # days before the ignitions kept out of the baseline and used as unburned looks

TRAINING = [WorldPlan(100 + n, 33.0 + 0.4 * n, -120.0 + 2.7 * n, first_day="2021-06-01") for n in range(12)]
CALIBRATION = [WorldPlan(200 + n, 36.0 - 3.0 * n, -84.0 + 3.0 * n, first_day="2021-07-10") for n in range(4)]
HELD_OUT = [WorldPlan(300 + n, -14.0 - 2.8 * n, 16.0 + 3.0 * n, first_day="2022-08-01") for n in range(4)]


@dataclass(frozen=True)
class Examples:
    """Looks as features with their labels and mode, one row a look."""

    table: pd.DataFrame
    burned: NDArray[np.bool_]
    raw_if: NDArray[np.bool_]


def world_examples(plan: WorldPlan, folder: Path, raw_if_share: float = RAW_IF_SHARE) -> Examples:
    """Simulate a world, build its baseline from the days before, and label the looks around and after the ignitions."""
    surface = make_surface(plan)
    split_ms = plan.ignition_ms - UNBURNED_LEAD_DAYS * DAY_MS
    before = make_specular_points(plan, plan.first_ms, split_ms, stream=0)
    after = make_specular_points(plan, split_ms, plan.end_ms, stream=1)
    paths = [folder / f"{plan.seed}_{name}.nc" for name in ("before", "nominal", "raw_if")]
    simulate_nominal(before, surface, plan.seed * 10 + 1).write(paths[0], {})
    simulate_nominal(after, surface, plan.seed * 10 + 2).write(paths[1], {})
    images = make_images(after, raw_if_share, plan.seed)
    simulate_raw_if(after, images, surface, plan.seed * 10 + 3).write(paths[2], {})
    baseline = build_baseline(read_observations(paths[:1]).looks)
    layers = Layers(soil_moisture=make_soil_moisture(plan, surface))
    looks = with_ancillary(read_observations(paths[1:]).looks, layers)
    latitude, longitude = np.meshgrid(surface.burn_latitude_deg, surface.burn_longitude_deg, indexing="ij")
    label = label_looks(looks, labels_table(latitude, longitude, surface.burn_time))
    known = label != UNKNOWN
    table = feature_table(looks, baseline)[known].reset_index(drop=True)
    return Examples(table, label[known] == BURNED, (looks["mode"] == "raw-if").to_numpy()[known])


def gather(plans: Sequence[WorldPlan], raw_if_share: float = RAW_IF_SHARE) -> Examples:
    """Examples of several worlds, in their order."""
    with tempfile.TemporaryDirectory() as name:
        parts = [world_examples(plan, Path(name), raw_if_share) for plan in plans]
    return Examples(
        pd.concat([part.table for part in parts], ignore_index=True),
        np.concatenate([part.burned for part in parts]),
        np.concatenate([part.raw_if for part in parts]),
    )


def fit(training: Examples, calibration: Examples, features: tuple[str, ...] = FEATURES) -> BurnedModel:
    """A model of both modes, calibrated on worlds of its own."""
    table = pd.concat([training.table, calibration.table], ignore_index=True)
    held = np.arange(len(table)) >= len(training.table)
    return train(table, np.concatenate([training.burned, calibration.burned]), held, features)


def ablations() -> dict[str, tuple[str, ...]]:
    """Feature sets of the comparison: all, without change, without texture, without both."""
    no_change = tuple(name for name in FEATURES if name not in CHANGE_FEATURES)
    no_texture = tuple(name for name in FEATURES if name not in TEXTURE_FEATURES)
    return {
        "all features": FEATURES,
        "no change features": no_change,
        "no texture features": no_texture,
        "all and ancillary soil moisture": (*FEATURES, "ancillary_soil_moisture"),
        "neither": tuple(name for name in no_change if name in no_texture),
    }


def scores(model: BurnedModel, test: Examples) -> dict[str, float]:
    """AUC over all looks and by mode, Brier score and verdict quality on examples that the model never saw."""
    probability = model.probability(test.table)
    called = probability >= model.threshold
    hits = float((called & test.burned).sum())
    return {
        "auc": auc(probability, test.burned),
        "auc_nominal": auc(probability[~test.raw_if], test.burned[~test.raw_if]),
        "auc_raw_if": auc(probability[test.raw_if], test.burned[test.raw_if]),
        "brier": float(np.mean((probability - test.burned) ** 2)),
        "recall": hits / max(float(test.burned.sum()), 1.0),
        "precision": hits / max(float(called.sum()), 1.0),
    }


def best_single_feature(training: Examples, test: Examples) -> tuple[str, float]:
    """The feature whose value alone ranks the training looks best (either sign), and its AUC on the test looks."""
    found = {name: auc(training.table[name].to_numpy(np.float64), training.burned) for name in FEATURES}
    name = max(found, key=lambda key: abs(found[key] - 0.5))
    sign = 1.0 if found[name] >= 0.5 else -1.0
    return name, auc(sign * test.table[name].to_numpy(np.float64), test.burned)


def calibration_table(model: BurnedModel, test: Examples) -> list[tuple[float, float, int]]:
    """Mean probability, burned share and count by tenths of probability."""
    probability = model.probability(test.table)
    bins = np.minimum((probability * 10).astype(int), 9)
    return [
        (float(probability[bins == k].mean()), float(test.burned[bins == k].mean()), int((bins == k).sum()))
        for k in range(10)
        if (bins == k).any()
    ]


def main() -> None:
    """Train, score on the held-out worlds, write the model and its card."""
    training, calibration, test = gather(TRAINING), gather(CALIBRATION), gather(HELD_OUT)
    rows = []
    for name, features in ablations().items():
        model = fit(training, calibration, features)
        rows.append((name, scores(model, test)))
        if features == FEATURES:
            model.save(MODEL_PATH)
            shipped = model
    name, single = best_single_feature(training, test)
    CARD_PATH.write_text(_card(shipped, training, calibration, test, rows, (name, single)), encoding="utf-8")


def _card(shipped: BurnedModel, training: Examples, calibration: Examples, test: Examples, rows, single) -> str:
    """The model card: what it learnt from, how it scores beside plain baselines, what to mind."""
    sizes = [f"{len(p.table)} looks, {100 * p.burned.mean():.1f} % burned" for p in (training, calibration, test)]
    keys = ("auc", "auc_nominal", "auc_raw_if", "brier")
    lines = [f"| {name} | " + " | ".join(f"{score[key]:.3f}" for key in keys) + " |" for name, score in rows]
    tenths = [f"| {mean:.2f} | {share:.2f} | {count} |" for mean, share, count in calibration_table(shipped, test)]
    return CARD.format(
        features=len(shipped.features),
        size=MODEL_PATH.stat().st_size / 2**20,
        worlds=(len(TRAINING), len(CALIBRATION), len(HELD_OUT)),
        sizes=sizes,
        scores="\n".join(lines),
        single=single,
        threshold=shipped.threshold,
        recall=rows[0][1]["recall"],
        precision=rows[0][1]["precision"],
        tenths="\n".join(tenths),
    )


CARD = """# Burned-area model

**Trained and scored on simulated delay-Doppler maps only.** No labelled real maps are public; nothing here says how
well it does on real ones.

XGBoost, {features} features, {size:.2f} MiB UBJ, calibrated by a logistic curve on worlds of its own. Made by
`python -m services.retrieval.burned_area.shipped_model`, which writes this card too.

- Training: {worlds[0]} worlds, {sizes[0]}
- Calibration and threshold: {worlds[1]} other worlds, {sizes[1]}
- Held out: {worlds[2]} worlds on another continent a year later, {sizes[2]}

## Held-out worlds

| features | AUC | AUC nominal | AUC raw-IF | Brier |
|---|---|---|---|---|
{scores}
| best single feature (`{single[0]}`) | {single[1]:.3f} | | | |

At the threshold {threshold:.2f}: recall {recall:.2f}, precision {precision:.2f} a look. The rows say what each
group of features is worth; "no change features" is what a place without a baseline gets.

| mean probability | burned share | looks |
|---|---|---|
{tenths}

## Mind

- What fire does to the signal is assumed: vegetation depth -55 to -90 %, roughness +5 to +30 %, moisture -5 to -25 %.
- Looks differ by 1 dB at random in the simulation; real neighbouring looks over Texas by at most 1.2 dB each.
- Probabilities hold for the burned share above; where burned land is rarer they are too high.
- A tenth of the training looks had their change features hidden, so that places without a baseline get a verdict too.
  That verdict is worth little: see the row without change features.
"""


if __name__ == "__main__":
    main()
