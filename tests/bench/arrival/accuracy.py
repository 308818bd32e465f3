"""The default method beside the support vector machine: synthetic fires, WRF-SFIRE fires, real outlines."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from services.arrival.fires import map_case
from services.arrival.inference import DEFAULT_METHOD, FIT_ALONE
from tests.services.arrival.airborne import FIRES as AIRBORNE
from tests.services.arrival.airborne import airborne_case
from tests.services.arrival.mapped_fires import FIRES as MAPPED
from tests.services.arrival.mapped_fires import OutlineScore, compare
from tests.services.arrival.scored import Score, case_of, score, truth_on
from tests.services.arrival.seeds import BENCH, TUNING
from tests.services.arrival.synthetic_fires import make_fire
from tests.services.arrival.wrf_sfire_fires import arrival_maps, wrf_sfire_fire

Show = Callable[..., None]
METHODS = {"": DEFAULT_METHOD, "svm_": "svm", "field_": FIT_ALONE}
SYNTHETIC_FIRES = 20
OBSERVATIONS = 20_000
WRF_CELL_M = 100.0


def mean(scores: Sequence[Score], name: str) -> float:
    return float(np.nanmean([getattr(entry, name) for entry in scores]))


def interval(differences: Sequence[float]) -> tuple[float, float]:
    """95 % bootstrap interval of the mean of differences (n,); NaNs left out."""
    known = np.array([value for value in differences if np.isfinite(value)])
    if known.size == 0:
        return float("nan"), float("nan")
    draws = np.random.default_rng(0).choice(known, (2000, known.size)).mean(axis=1)
    return float(np.quantile(draws, 0.025)), float(np.quantile(draws, 0.975))


def climatological_spread_h() -> float:
    """CRPS of a forecast that knows only how arrival hours are spread over other fires: half the mean difference of
    two arrivals, taken over tuning fires."""
    hours = np.concatenate([(t := make_fire(seed).arrival_h)[np.isfinite(t)][::7] for seed in TUNING[40:50]])
    hours = np.sort(hours)
    rank = 2 * np.arange(1, hours.size + 1) - hours.size - 1
    return float((rank * hours).sum() / hours.size**2)


def synthetic(show: Show) -> None:
    """Unseen seeds, both methods on the same looks."""
    results: dict[str, list[Score]] = {prefix: [] for prefix in METHODS}
    for seed in BENCH[:SYNTHETIC_FIRES]:
        fire = make_fire(seed, observations=OBSERVATIONS)
        case = case_of(fire)
        truth = truth_on(case, fire)
        for prefix, method in METHODS.items():
            results[prefix].append(score(map_case(case, method, 0), truth))
    bars = {"mae_h": 3.0, "bias_h": "-1..1", "f1": 0.95}
    for prefix, scores in results.items():
        for name, unit in (("mae_h", "h"), ("bias_h", "h"), ("f1", "1")):
            show(f"{prefix}synthetic_{name}", mean(scores, name), unit, None if prefix else bars[name])
    peer, climate = mean(results["svm_"], "mae_h"), climatological_spread_h()
    show("crps_h", mean(results[""], "crps_h"), "h", f"< {min(peer, climate):.3f}")
    show("climatological_crps_h", climate, "h")
    show("interval90_coverage", mean(results[""], "coverage90"), "1", "0.85..0.95")
    show("field_crps_h", mean(results["field_"], "crps_h"), "h")
    show("field_interval90_coverage", mean(results["field_"], "coverage90"), "1")


def wrf_sfire(show: Show, data: Path) -> None:
    """The six simulated fires under simulated overpasses."""
    results: dict[str, list[Score]] = {prefix: [] for prefix in METHODS}
    for index, hours in enumerate(arrival_maps(data)):
        fire = wrf_sfire_fire(hours, BENCH[index])
        case = case_of(fire, WRF_CELL_M)
        truth = truth_on(case, fire)
        for prefix, method in METHODS.items():
            results[prefix].append(score(map_case(case, method, 0), truth))
    for prefix, scores in results.items():
        show(f"{prefix}wrf_sfire_mae_h", mean(scores, "mae_h"), "h", None if prefix else 5.0)
        show(f"{prefix}wrf_sfire_bias_h", mean(scores, "bias_h"), "h")
        show(f"{prefix}wrf_sfire_f1", mean(scores, "f1"), "1", None if prefix else 0.80)
        show(f"{prefix}wrf_sfire_interval90_coverage", mean(scores, "coverage90"), "1")


def airborne(show: Show, data: Path) -> None:
    """Bobcat and Mineral against what an aircraft saw in infrared."""
    cases = {name: airborne_case(data, name) for name in AIRBORNE}
    for prefix, method in {**METHODS, "nearest_": "nearest-detection"}.items():
        values = {name: case.sorensen(method) for name, case in cases.items()}
        show(f"{prefix}ir_perimeter_sorensen", np.mean(list(values.values())), "1", None if prefix else 0.80)
        for name, value in values.items():
            show(f"{prefix}ir_perimeter_sorensen_{name}", value, "1")


def mapped(show: Show, data: Path) -> None:
    """Black, Cerro Pelado, Cooks Peak, Tunnel: per fire the means over outlines, and differences from the machine."""
    for name in MAPPED:
        label = name.lower().replace(" ", "_")
        scores = compare(data, name, (DEFAULT_METHOD, "svm"))
        if not scores:
            show(f"hms_{label}_detections", 0, "1", "none in the detections at hand: no map to score")
            continue
        ours, peer = scores[DEFAULT_METHOD], scores["svm"]
        show(f"hms_{label}_outlines", len(ours), "1")
        for field, unit in zip(fields(OutlineScore), ("1", "h", "1"), strict=True):
            a, b = (np.array([getattr(entry, field.name) for entry in entries]) for entries in (ours, peer))
            show(f"hms_{label}_{field.name}", np.nanmean(a), unit)
            show(f"svm_hms_{label}_{field.name}", np.nanmean(b), unit)
            low, high = interval(a - b)
            show(f"hms_{label}_{field.name}_minus_svm", np.nanmean(a - b), unit, f"95 %: {low:.3f}..{high:.3f}")


def accuracy(show: Show) -> None:
    """All that the short run compares; what rests on real data only with SMOKEGLINT_DATA."""
    synthetic(show)
    folder = os.environ.get("SMOKEGLINT_DATA")
    if folder:
        for part in (wrf_sfire, airborne, mapped):
            part(show, Path(folder))
