"""The paper's two claims on burned area, measured on simulated worlds, with an ablation and a second case.

``python -m tests.bench.retrieval.burned_claims`` prints the whole table; ``headline`` gives the benchmark its figures.
Worlds that train, that calibrate and that are scored lie in other regions and years. The first case stands for large
fires in CONUS; the second, south of the equator, for small agricultural burns (northern Angola in the paper). Recall
is always that at which 5 % of unburned looks are called burned, so that two models are compared at one price.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.ancillary.layers import ANCILLARY_FEATURES
from services.retrieval.burned_area.model import FEATURES, auc, train
from services.retrieval.burned_area.shipped_model import Examples, gather
from services.retrieval.looks.baseline import CHANGE_FEATURES
from services.retrieval.looks.features import TEXTURE_FEATURES
from services.retrieval.simulation.training_world import WorldPlan

TRAINING = [WorldPlan(6100 + n, 33.0 + 0.9 * n, -120.0 + 4.0 * n, first_day="2021-06-01") for n in range(6)]
CALIBRATION = [WorldPlan(6200 + n, 36.0 - 3.0 * n, -84.0 + 3.0 * n, first_day="2022-07-10") for n in range(2)]
CONUS = [WorldPlan(6300 + n, 36.5 + 3.0 * n, -108.0 - 6.0 * n, first_day="2023-08-01") for n in range(2)]
SMALL = {"fires": 150, "fire_radius_km": (0.6, 3.0)}
ANGOLA = [WorldPlan(6400 + n, -8.5 - 2.8 * n, 16.0 + 3.0 * n, first_day="2023-06-01", **SMALL) for n in range(2)]
FALSE_ALARMS = 0.05
RESAMPLES = 30
RAW_IF_SHARE = 0.4  # of the seconds after the ignitions: enough raw-IF looks for a model of their own
NO_TEXTURE = tuple(name for name in FEATURES if name not in TEXTURE_FEATURES)
SINGLE = tuple(name for name in FEATURES if name not in CHANGE_FEATURES)
SINGLE_NO_TEXTURE = tuple(name for name in SINGLE if name not in TEXTURE_FEATURES)
MODES = {"nominal": False, "raw_if": True}


@dataclass(frozen=True)
class Score:
    """AUC, recall at FALSE_ALARMS and the standard errors of both (by resampling of looks)."""

    auc: float
    recall: float
    auc_error: float
    recall_error: float


def pick(examples: Examples, rows: NDArray[np.bool_]) -> Examples:
    return Examples(examples.table[rows].reset_index(drop=True), examples.burned[rows], examples.raw_if[rows])


def join(parts: list[Examples]) -> Examples:
    return Examples(
        pd.concat([part.table for part in parts], ignore_index=True),
        np.concatenate([part.burned for part in parts]),
        np.concatenate([part.raw_if for part in parts]),
    )


def predict(training: Examples, calibration: Examples, test: Examples, features: tuple[str, ...]) -> NDArray:
    """Probability of the test looks by a model of the training looks."""
    both = join([training, calibration])
    held = np.arange(len(both.table)) >= len(training.table)
    return train(both.table, both.burned, held, features).probability(test.table)


def recall_at(probability: NDArray, burned: NDArray[np.bool_]) -> float:
    """Share of burned looks above the probability that FALSE_ALARMS of the unburned ones reach."""
    return float((probability[burned] > np.quantile(probability[~burned], 1.0 - FALSE_ALARMS)).mean())


def score(probability: NDArray, burned: NDArray[np.bool_]) -> Score:
    rng = np.random.default_rng(0)
    draws = [rng.integers(0, burned.size, burned.size) for _ in range(RESAMPLES)]
    aucs, recalls = (np.std([measure(probability[d], burned[d]) for d in draws]) for measure in (auc, recall_at))
    return Score(auc(probability, burned), recall_at(probability, burned), float(aucs), float(recalls))


def compare(training: Examples, calibration: Examples, test: Examples) -> dict[str, Score]:
    """Scores of every model of the comparison on one set of held-out worlds."""
    found = {}
    for name, features in {
        "all features": FEATURES,
        "no texture": NO_TEXTURE,
        "no change": SINGLE,
        "neither": SINGLE_NO_TEXTURE,
        "and ancillary soil moisture": (*FEATURES, ANCILLARY_FEATURES[0]),
    }.items():
        found[f"joint, {name}"] = score(predict(training, calibration, test, features), test.burned)
    nominal = [pick(part, ~part.raw_if) for part in (training, calibration)]
    found["nominal only, all features"] = score(predict(*nominal, test, FEATURES), test.burned)
    for mode, raw_if in MODES.items():
        parts = [pick(part, part.raw_if == raw_if) for part in (training, calibration, test)]
        for name, features in {
            "all features": FEATURES,
            "no texture": NO_TEXTURE,
            "no change": SINGLE,
            "neither": SINGLE_NO_TEXTURE,
        }.items():
            found[f"{mode} alone, {name}"] = score(predict(*parts, features), parts[2].burned)
    return found


def gain(found: dict[str, Score], mode: str) -> float:
    """Relative gain in recall that texture brings to a model of one mode that has every other feature."""
    without = found[f"{mode} alone, no texture"].recall
    return found[f"{mode} alone, all features"].recall / without - 1.0 if without else float("nan")


def headline() -> dict[str, float]:
    """The benchmark's figures, of the first case: recalls by training, and relative gain in recall by texture."""
    training, calibration, test = (gather(plans, RAW_IF_SHARE) for plans in (TRAINING, CALIBRATION, CONUS))
    nominal = [pick(part, ~part.raw_if) for part in (training, calibration)]
    figures = {
        "burned_recall_nominal": recall_at(predict(*nominal, test, FEATURES), test.burned),
        "burned_recall_joint": recall_at(predict(training, calibration, test, FEATURES), test.burned),
    }
    for mode, raw_if in MODES.items():
        parts = [pick(part, part.raw_if == raw_if) for part in (training, calibration, test)]
        full, bare = (recall_at(predict(*parts, names), parts[2].burned) for names in (FEATURES, NO_TEXTURE))
        figures[f"texture_gain_{mode}"] = full / bare - 1.0 if bare else float("nan")
    return figures


def measure() -> dict[str, dict[str, Score]]:
    """The comparison by case: ``conus`` and ``angola``."""
    training, calibration = gather(TRAINING, RAW_IF_SHARE), gather(CALIBRATION, RAW_IF_SHARE)
    return {
        name: compare(training, calibration, gather(plans, RAW_IF_SHARE))
        for name, plans in (("conus", CONUS), ("angola", ANGOLA))
    }


def main() -> None:
    """Print the table of the page."""
    for case, found in measure().items():
        print(f"\n{case}\n| model | AUC | recall at 5 % false alarms |\n|---|---|---|")
        for name, value in found.items():
            print(
                f"| {name} | {value.auc:.3f} ± {value.auc_error:.3f} | {value.recall:.3f} ± {value.recall_error:.3f} |"
            )
        joint, nominal = found["joint, all features"].recall, found["nominal only, all features"].recall
        print(f"\nrecall by joint training: {100 * (joint / nominal - 1):+.1f} %")
        print("recall by texture:", {mode: f"{100 * gain(found, mode):+.1f} %" for mode in MODES})


if __name__ == "__main__":
    main()
