"""The learned correction: what it reads against plain sums, its symmetries, and what it gives on fires it never saw."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from services.arrival import inference
from services.arrival.extent import Evidence, gather
from services.arrival.field import Field, fit_field
from services.arrival.fires import FireCase, case_report, map_case
from services.arrival.grid import FireGrid
from services.arrival.looks import BURNED_AREA, FIRE, NO_FIRE, Ignition, Looks
from services.arrival.posterior import network
from services.arrival.posterior.channels import AGE_STEP_H, AGES, YOUNGEST_H, by_age, channels
from services.arrival.posterior.correction import FEWEST, quantiles, unlearned
from services.arrival.posterior.square import CELLS, Square, square_around
from tests.services.arrival.scored import case_of, score, truth_on
from tests.services.arrival.seeds import TESTS
from tests.services.arrival.synthetic_fires import make_fire

SQUARE = Square(0.2 * np.arange(9.0), 0.2 * np.arange(7.0), 0.2)


def _looks(count: int, seed: int, kind: int = FIRE) -> Looks:
    rng = np.random.default_rng(seed)
    kinds, zeros = np.full(count, kind, np.int8), np.zeros(count, np.int8)
    size = np.full(count, 0.2)
    place = rng.uniform(0.1, 1.3, (2, count))
    return Looks(*place, np.sort(rng.uniform(0, 60, count)), kinds, zeros, np.ones(count), size, size)


def test_looks_by_age_are_the_plain_sum_over_looks_and_cells() -> None:
    looks, sigma = _looks(12, 1), np.linspace(0.15, 0.4, 12)
    arrival = np.random.default_rng(2).uniform(0, 60, (7, 9))
    expected = np.zeros((AGES, 7, 9))
    for k in range(12):
        for row in range(7):
            for column in range(9):
                squared = (0.2 * column - looks.x_km[k]) ** 2 + (0.2 * row - looks.y_km[k]) ** 2
                if squared > 4 * sigma[k] ** 2:
                    continue
                place = np.clip((looks.time_h[k] - arrival[row, column] - YOUNGEST_H) / AGE_STEP_H, 0, AGES - 1)
                for age in range(AGES):
                    share = max(1.0 - abs(place - age), 0.0)
                    expected[age, row, column] += share * np.exp(-0.5 * squared / sigma[k] ** 2)
    np.testing.assert_allclose(by_age(SQUARE, looks, sigma, arrival), np.log1p(expected), rtol=1e-4, atol=1e-5)


def test_quantiles_are_where_the_steps_of_a_distribution_reach_them() -> None:
    probability = np.random.default_rng(3).dirichlet(np.full(network.OFFSETS, 0.3), 5).T
    edges = network.EARLIEST_H + network.OFFSET_STEP_H * (np.arange(network.OFFSETS + 1) - 0.5)
    found = quantiles(probability, (0.05, 0.5, 0.95))
    for column in range(5):
        reached = np.concatenate([[0.0], np.cumsum(probability[:, column])])
        np.testing.assert_allclose(found[:, column], np.interp([0.05, 0.5, 0.95], reached, edges), atol=1e-6)


def _setting(shift_h: float = 0.0) -> tuple[Square, Looks, Field, Evidence, Ignition, float]:
    """Looks at a front that runs east, fitted as it was, all of it later by `shift_h`."""
    fire, clear = _looks(40, 4), _looks(30, 5, NO_FIRE)
    looks = Looks(**{name: np.concatenate([getattr(part, name) for part in (fire, clear)]) for name in vars(fire)})
    looks = replace(looks, time_h=looks.time_h + shift_h)
    square = square_around(looks.fire)
    axis = np.linspace(-6.0, 7.0, 66)
    arrival = np.broadcast_to(20.0 + 8.0 * axis, (66, 66)) + shift_h
    field = Field(axis, axis, np.array(arrival)[None], np.full((66, 66), 1.0), 6.0, 0.6, 1)
    grid = FireGrid(32613, 1e3 * square.x_km, 1e3 * square.y_km, 1e3 * square.cell_km)
    evidence = gather(grid, looks.moved(*(-value for value in grid.origin_km)))
    return square, looks, field, evidence, Ignition(shift_h, 0.2, 0.3), 70.0 + shift_h


def test_a_shifted_clock_reads_the_same() -> None:
    """Neither the hour of the day nor the reference time is read, only how looks and growth lie to each other."""
    first, later = (channels(*_setting(shift))[0] for shift in (0.0, 6.0))
    assert first.shape[1:] == (CELLS, CELLS) and np.isfinite(first).all()
    np.testing.assert_allclose(first, later, atol=2e-3)


def test_the_answer_turns_and_mirrors_with_the_fire() -> None:
    read = np.random.default_rng(6).normal(0, 0.5, (network.weights()["stem.weight"].shape[1], 16, 16))
    read, margin = read.astype(np.float32), np.random.default_rng(7).uniform(-2, 2, (16, 16))
    plain = network.predict(read, margin)
    turned = network.predict(np.rot90(read, 1, (1, 2)).copy(), np.rot90(margin).copy())
    np.testing.assert_allclose(np.rot90(plain[0], 1, (1, 2)), turned[0], atol=1e-5)
    np.testing.assert_allclose(np.rot90(plain[1]), turned[1], atol=1e-4)
    np.testing.assert_allclose(plain[0].sum(axis=0), 1.0, atol=1e-4)


@pytest.fixture(scope="module")
def cases() -> Iterator[list[tuple[FireCase, np.ndarray]]]:
    """Two fires with their truth, each fitted once for all tests."""
    fires = [make_fire(TESTS[k], observations=4000) for k in (3, 6)]
    fitted: dict[float, Field] = {}

    def once(looks: Looks, *rest: Any) -> Field:
        key = float(looks.x_km.sum())
        if key not in fitted:
            fitted[key] = fit_field(looks, *rest)
        return fitted[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inference, "fit_field", once)
        yield [(case := case_of(fire), truth_on(case, fire)) for fire in fires]


def test_corrected_maps_are_nearer_to_the_truth_than_the_fit_alone(cases: list[tuple[FireCase, np.ndarray]]) -> None:
    ours, alone = (
        [score(map_case(case, method, 0), truth) for case, truth in cases]
        for method in ("arrival-posterior", "arrival-field")
    )
    for name, better in (("mae_h", -1), ("crps_h", -1), ("f1", 1)):
        gain = better * np.mean([getattr(a, name) - getattr(b, name) for a, b in zip(ours, alone, strict=True)])
        assert gain > 0.0, name
    assert 0.75 < np.mean([entry.coverage90 for entry in ours]) < 0.99


def test_a_network_that_says_nothing_leaves_the_fit(
    cases: list[tuple[FireCase, np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    silent = {name: torch.zeros_like(values) for name, values in network.weights().items()}
    case = cases[0][0]
    alone = map_case(case, "arrival-field", 0)
    monkeypatch.setattr(network, "weights", lambda: silent)
    same = map_case(case, "arrival-posterior", 0)
    both = np.isfinite(alone.arrival_h) & np.isfinite(same.arrival_h)
    assert both.sum() > 0.9 * np.isfinite(alone.arrival_h).sum()
    np.testing.assert_allclose(same.arrival_h[both], alone.arrival_h[both], atol=0.01)


def test_few_sightings_get_the_fit_alone_and_the_report_says_so(cases: list[tuple[FireCase, np.ndarray]]) -> None:
    case = cases[0][0]
    first = np.flatnonzero(case.looks.kind == FIRE)[: FEWEST - 1]
    few = np.sort(np.concatenate([first, np.flatnonzero(case.looks.kind != FIRE)[:300]]))
    poor = replace(case, looks=case.looks.take(few))
    ours, alone = (map_case(poor, method, 0) for method in ("arrival-posterior", "arrival-field"))
    np.testing.assert_array_equal(ours.arrival_h, alone.arrival_h)
    assert case_report(poor, ours)["basis"] == f"arrival-field: fewer than {FEWEST} sightings"
    assert case_report(poor, alone)["basis"] == ""


def test_looks_of_another_kind_are_not_corrected() -> None:
    fire, clear = _looks(40, 4), _looks(30, 5, NO_FIRE)
    looks = Looks(**{name: np.concatenate([getattr(part, name) for part in (fire, clear)]) for name in vars(fire)})
    usual, start = replace(looks, time_h=np.round(looks.time_h / 6.0) * 6.0), Ignition(0.0)
    assert unlearned(usual, start, 70.0) == ""
    assert "longer than 6.5 days" in unlearned(usual, start, 200.0)
    assert "passes a day" in unlearned(looks, start, 70.0)
    scars = replace(looks, kind=np.full(70, BURNED_AREA, np.int8))
    with_scars = Looks(
        **{name: np.concatenate([getattr(part, name) for part in (usual, scars)]) for name in vars(usual)}
    )
    assert unlearned(with_scars, start, 70.0) == ""
    assert "without fire" in unlearned(usual.fire, start, 70.0)
    assert "coarser" in unlearned(replace(usual, radius_km=np.full(70, 2.0)), start, 70.0)
    assert "one instant" in unlearned(replace(usual, time_h=np.full(70, 30.0)), start, 70.0)


def test_points_that_state_no_confidence_keep_the_fit(cases: list[tuple[FireCase, np.ndarray]]) -> None:
    fire = make_fire(TESTS[3], observations=4000)
    unrated = replace(fire, detections=fire.detections.assign(confidence=np.nan))
    case, rated = case_of(unrated), cases[0][0]
    assert not rated.unlike and "no confidence" in case.unlike
    corrected, kept, alone = (
        map_case(one, method, 0)
        for one, method in ((rated, "arrival-posterior"), (case, "arrival-posterior"), (rated, "arrival-field"))
    )
    assert kept.basis == f"arrival-field: {case.unlike}" and not corrected.basis
    np.testing.assert_array_equal(kept.arrival_h, alone.arrival_h)
    assert not np.array_equal(corrected.arrival_h, alone.arrival_h, equal_nan=True)


def test_threads_do_not_change_the_answer() -> None:
    read = np.random.default_rng(8).normal(0, 0.5, (network.weights()["stem.weight"].shape[1], CELLS, CELLS))
    read = read.astype(np.float32)
    answers = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        answers.append(network.predict(read, np.zeros((CELLS, CELLS)))[0])
    torch.set_num_threads(1)
    np.testing.assert_array_equal(*answers)


def test_the_model_is_small_numbers_with_a_card_that_says_where_they_come_from() -> None:
    assert network.MODEL.stat().st_size < 2**20
    with np.load(network.MODEL, allow_pickle=False) as stored:
        assert all(np.isfinite(stored[name]).all() for name in stored.files)
    assert "simulated" in network.MODEL.with_suffix(".md").read_text()
