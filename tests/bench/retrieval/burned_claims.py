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

SMALL = {"fires": 150, "fire_radius_km": (0.6, 3.0)}
REPLICATES = 5
FALSE_ALARMS = 0.05
RAW_IF_SHARE = 0.4  # of the seconds after the ignitions: enough raw-IF looks for a model of their own
TEXTURE_ALONE = ("incidence_deg", "rx_gain_dbi", *TEXTURE_FEATURES)
NO_TEXTURE = tuple(name for name in FEATURES if name not in TEXTURE_FEATURES)
SINGLE = tuple(name for name in FEATURES if name not in CHANGE_FEATURES)
SINGLE_NO_TEXTURE = tuple(name for name in SINGLE if name not in TEXTURE_FEATURES)
MODES = {"nominal": False, "raw_if": True}


def plans(replicate: int = 0) -> dict[str, list[WorldPlan]]:
    """Worlds that train and calibrate, and those of the two cases; every replicate has seeds of its own."""
    seed = 6000 + 10_000 * replicate
    made: dict[str, list[WorldPlan]] = {name: [] for name in ("training", "calibration", "conus", "angola")}
    for n in range(6):
        made["training"].append(WorldPlan(seed + 100 + n, 33.0 + 0.9 * n, -120.0 + 4.0 * n, first_day="2021-06-01"))
    for n in range(2):
        made["calibration"].append(WorldPlan(seed + 200 + n, 36.0 - 3.0 * n, -84.0 + 3.0 * n, first_day="2022-07-10"))
        made["conus"].append(WorldPlan(seed + 300 + n, 36.5 + 3.0 * n, -108.0 - 6.0 * n, first_day="2023-08-01"))
        made["angola"].append(
            WorldPlan(seed + 400 + n, -8.5 - 2.8 * n, 16.0 + 3.0 * n, first_day="2023-06-01", **SMALL)
        )
    return made


@dataclass(frozen=True)
class Score:
    """AUC, and recall at FALSE_ALARMS."""

    auc: float
    recall: float


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
    return Score(auc(probability, burned), recall_at(probability, burned))


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
            "texture only": TEXTURE_ALONE,
        }.items():
            found[f"{mode} alone, {name}"] = score(predict(*parts, features), parts[2].burned)
    return found


def gains(found: dict[str, Score]) -> dict[str, float]:
    """Relative gains in recall: by joint training, by texture within a mode, and of raw-IF over nominal maps where
    there is nothing but their texture.
    """
    pairs = {
        "joint training": ("joint, all features", "nominal only, all features"),
        "texture, nominal": ("nominal alone, all features", "nominal alone, no texture"),
        "texture, raw-IF": ("raw_if alone, all features", "raw_if alone, no texture"),
        "texture of raw-IF over that of nominal": ("raw_if alone, texture only", "nominal alone, texture only"),
    }
    recalls = {name: (found[one].recall, found[other].recall) for name, (one, other) in pairs.items()}
    return {name: one / other - 1.0 if other else float("nan") for name, (one, other) in recalls.items()}


def headline() -> dict[str, float]:
    """The benchmark's figures, of the first case: recalls by training, and relative gain in recall by texture."""
    worlds = plans()
    training, calibration, test = (gather(worlds[name], RAW_IF_SHARE) for name in ("training", "calibration", "conus"))
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


def measure(replicate: int = 0) -> dict[str, dict[str, Score]]:
    """The comparison by case: ``conus`` and ``angola``."""
    worlds = plans(replicate)
    training, calibration = gather(worlds["training"], RAW_IF_SHARE), gather(worlds["calibration"], RAW_IF_SHARE)
    return {case: compare(training, calibration, gather(worlds[case], RAW_IF_SHARE)) for case in ("conus", "angola")}


def main() -> None:
    """Print the tables of the page: means over replicates, and their standard errors (from replicate to replicate)."""
    found = []
    for replicate in range(REPLICATES):
        found.append(measure(replicate))
        print(replicate, {case: gains(scores) for case, scores in found[-1].items()}, flush=True)
    for case in ("conus", "angola"):
        print(f"\n{case}\n| model | AUC | recall at 5 % false alarms |\n|---|---|---|")
        for name in found[0][case]:
            scores = [one[case][name] for one in found]
            print(f"| {name} | {_mean([s.auc for s in scores])} | {_mean([s.recall for s in scores])} |")
        for name in gains(found[0][case]):
            print(f"gain in recall by {name}: {_mean([100 * gains(one[case])[name] for one in found], 0)} %")


def _mean(values: list[float], digits: int = 3) -> str:
    error = np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{np.mean(values):.{digits}f} ± {error:.{digits}f}"


if __name__ == "__main__":
    main()
