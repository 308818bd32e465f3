"""The long run: the paper's network and its ablations, its Table 2, and what the burned-area looks are worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import geopandas as gpd
import numpy as np
import torch
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits

from services.arrival.field import FieldSettings
from services.arrival.fires import map_case
from services.arrival.inference import DEFAULT_METHOD
from services.arrival.network import seeded
from services.arrival.paper_method import PaperSettings, undersample
from tests.bench.arrival.accuracy import OBSERVATIONS, mean
from tests.services.arrival.scored import Score, case_of, score, truth_on
from tests.services.arrival.seeds import BENCH
from tests.services.arrival.synthetic_fires import SIDE_KM, SyntheticFire, make_fire

Show = Callable[..., None]
NETWORK_FIRES = 4
TABLE2_FIRES = 4
VALUE_FIRES = 3
TRACKS = 40
# Noise of a look's log-odds: a raw-IF look is the sharper one.
RAW_IF_NOISE, NOMINAL_NOISE = 0.7, 1.5
ABLATIONS = {
    "no_clock": FieldSettings(clock=False),
    "no_no_fire_looks": FieldSettings(no_fire=False),
    "fixed_residence": FieldSettings(residence_spread=0.02),
    "ensemble_4": FieldSettings(members=4),
}


def network_rows(show: Show) -> None:
    """The paper's network with and without its bias correction, the plain baseline, and ablations of the default."""
    cases = []
    for seed in BENCH[:NETWORK_FIRES]:
        fire = make_fire(seed, observations=OBSERVATIONS)
        case = case_of(fire)
        cases.append((case, truth_on(case, fire)))
    rows = {
        "nn_": ("fusion-nn", PaperSettings()),
        "nn_bias_corrected_": ("fusion-nn", PaperSettings(bias_correction=True)),
        "nearest_": ("nearest-detection", None),
        "full_": (DEFAULT_METHOD, FieldSettings()),
        "fit_alone_": ("arrival-field", FieldSettings()),
        **{f"{name}_": ("arrival-field", settings) for name, settings in ABLATIONS.items()},
    }
    for prefix, (method, settings) in rows.items():
        scores: list[Score] = [score(map_case(case, method, 0, settings), truth) for case, truth in cases]
        for name, unit in (("mae_h", "h"), ("bias_h", "h"), ("f1", "1")):
            show(f"{prefix}synthetic_{name}_first{NETWORK_FIRES}", mean(scores, name), unit)


def _places(fire: SyntheticFire, table: gpd.GeoDataFrame) -> np.ndarray:
    projected = table.to_crs(fire.crs)
    corner = np.array([fire.x_m[0], fire.y_m[0]])
    points = np.column_stack([projected.geometry.x, projected.geometry.y])
    return 2 * (points - corner) / (SIDE_KM * 1e3) - 1


def _classifier(place: np.ndarray, label: np.ndarray, seed: int) -> nn.Module:
    """The paper's classifier on coordinates alone: dense layers, batch norm, dropout, undersampling, Adam."""
    chosen = undersample(label, seeded(seed))
    inputs, wanted = torch.tensor(place[chosen]).float(), torch.tensor(label[chosen]).float()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        layers: list[nn.Module] = []
        for size in (2, 64, 64):
            layers += [nn.Linear(size, 64), nn.BatchNorm1d(64), nn.ReLU(), nn.Dropout(0.2)]
        network = nn.Sequential(*layers, nn.Linear(64, 1))
        optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
        for _ in range(80):
            for rows in torch.randperm(len(inputs)).split(128):
                if rows.numel() > 1:
                    optimiser.zero_grad()
                    binary_cross_entropy_with_logits(network(inputs[rows])[:, 0], wanted[rows]).backward()
                    optimiser.step()
    return network.eval()


def _accuracy(network: nn.Module, place: np.ndarray, label: np.ndarray) -> float:
    with torch.no_grad():
        said = network(torch.tensor(place).float())[:, 0].numpy() > 0
    return float((said == label).mean())


def _held_out(place: np.ndarray, how: str, seed: int) -> np.ndarray:
    """Test rows: a fifth at random, or a fifth of the 3 km blocks (space that training never saw)."""
    rng = np.random.default_rng(seed)
    if how == "random":
        return rng.random(len(place)) < 0.2
    block = np.floor((place + 1) * SIDE_KM / 6.0).astype(int)
    return np.isin(block[:, 0] * 100 + block[:, 1], rng.permutation(10_000)[:2_000])


def table2(show: Show) -> None:
    """Coordinates in, burned at any time out; trained on detections alone, and with nominal and raw-IF burned area
    looks; always tested on active-fire points, at random and apart in space."""
    rows: dict[str, list[float]] = {}
    for seed in BENCH[:TABLE2_FIRES]:
        fire = make_fire(seed, tracks=TRACKS, noise=RAW_IF_NOISE)
        nominal = make_fire(seed, tracks=TRACKS, noise=NOMINAL_NOISE, mode="nominal").burned_area
        # A look without fire at a place that burned at some time has the label of the place, as the paper defines it.
        truth = np.isfinite(fire.arrival_h)
        place = _places(fire, fire.detections)
        index = np.clip(((place + 1) / 2 * len(truth)).astype(int), 0, len(truth) - 1)
        label = fire.detections["fire"].to_numpy(bool)
        burned_at_any_time = label | truth[index[:, 1], index[:, 0]]
        for how in ("random", "space"):
            test = _held_out(place, how, seed)
            for name, extra in (("af", None), ("af_nominal", nominal), ("af_raw_if", fire.burned_area)):
                x, y = place[~test], label[~test]
                if extra is not None:
                    where = _places(fire, extra)
                    # Looks in held-out blocks may train: they are another source, and the test is on fire points.
                    x, y = np.vstack([x, where]), np.append(y, extra["burned"].to_numpy(bool))
                network = _classifier(x, y, seed)
                rows.setdefault(f"table2_{name}_{how}", []).append(
                    _accuracy(network, place[test], burned_at_any_time[test])
                )
    paper = {"af": 0.7208, "af_nominal": 0.845, "af_raw_if": 0.8604}
    for name, values in rows.items():
        stem = name.removeprefix("table2_").rsplit("_", 1)[0]
        show(name, np.mean(values), "1", f"paper {paper[stem]}, another fire")


def _pair(seed: int, **changed: float) -> tuple[Score, Score]:
    """Scores with and without burned-area looks of the same fire."""
    fire = make_fire(seed, observations=OBSERVATIONS, tracks=TRACKS, noise=RAW_IF_NOISE, **changed)
    blind = replace(fire, burned_area=fire.burned_area.iloc[:0])
    scores = []
    for each in (fire, blind):
        case = case_of(each)
        scores.append(score(map_case(case, DEFAULT_METHOD, 0), truth_on(case, each)))
    return scores[0], scores[1]


def value(show: Show) -> None:
    """Error and extent against cloud, and against the delay of burned-area looks, with and without them."""
    seeds = BENCH[:VALUE_FIRES]
    for cloud in (0.0, 0.3, 0.6, 0.9):
        _value_rows(show, f"cloud_{round(100 * cloud)}", [_pair(seed, cloudiness=cloud) for seed in seeds])
    for delay in (6, 24, 48):
        rows = [_pair(seed, cloudiness=0.6, delay_h=float(delay)) for seed in seeds]
        _value_rows(show, f"cloud_60_delay_{delay}h", rows)


def _value_rows(show: Show, label: str, pairs: list[tuple[Score, Score]]) -> None:
    for suffix, scores in (("with_cygnss", [a for a, _ in pairs]), ("without_cygnss", [b for _, b in pairs])):
        show(f"value_{label}_{suffix}_mae_h", mean(scores, "mae_h"), "h")
        show(f"value_{label}_{suffix}_f1", mean(scores, "f1"), "1")


def fusion(show: Show) -> None:
    """All of the long run."""
    network_rows(show)
    table2(show)
    value(show)
