"""Arrival maps of synthetic fires whose truth is known, and of evidence too poor for a map."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from services.arrival.field import FieldSettings
from services.arrival.fires import map_case
from services.arrival.inference import FORMER_NAMES, METHODS, infer_arrival
from services.arrival.looks import FIRE, NO_FIRE, Ignition
from services.arrival.network import seeded
from services.arrival.paper_method import PaperSettings, fit_paper, undersample
from shared.errors import DomainError
from tests.services.arrival.scored import FireCase, Score, case_of, run, score, truth_on
from tests.services.arrival.seeds import BENCH, TESTS, TUNING
from tests.services.arrival.synthetic_fires import SyntheticFire, make_fire

FAST = FieldSettings(steps=60, members=2)


@pytest.fixture(scope="module")
def fire() -> SyntheticFire:
    return make_fire(TESTS[2], observations=3000)


@pytest.fixture(scope="module")
def case(fire: SyntheticFire) -> FireCase:
    return case_of(fire)


def test_seed_ranges_are_disjoint() -> None:
    assert len({*TUNING, *TESTS, *BENCH}) == len(TUNING) + len(TESTS) + len(BENCH)


def test_the_generator_repeats_itself_and_is_a_fire(fire: SyntheticFire) -> None:
    again = make_fire(TESTS[2], observations=3000)
    pd.testing.assert_frame_equal(fire.detections, again.detections)
    burned = np.isfinite(fire.arrival_h)
    assert 10 < burned.sum() * 0.09 < 700
    assert fire.detections["fire"].sum() > 50
    assert 25 <= fire.detections["time"].nunique() <= 40


def test_default_beats_the_support_vectors_the_plain_baseline_and_the_papers_network() -> None:
    fires = [make_fire(seed, observations=3000) for seed in TESTS[3:5]]
    ours = [run(fire, settings=FieldSettings())[1] for fire in fires]
    plain = [run(fire, "nearest-detection")[1] for fire in fires]
    paper = [run(fire, "fusion-nn", PaperSettings(epochs=20))[1] for fire in fires]

    def mean(scores: list[Score]) -> float:
        return float(np.mean([entry.mae_h for entry in scores]))

    peer = [run(fire, "svm")[1] for fire in fires]
    assert mean(ours) < 5.0
    assert mean(ours) < 0.8 * mean(peer)
    assert mean(ours) < 0.8 * mean(plain)
    assert mean(ours) < 0.5 * mean(paper)
    assert min(entry.f1 for entry in ours) > 0.88
    assert all(0.75 <= entry.coverage90 <= 1.0 for entry in ours)


def test_same_seed_same_map_and_another_seed_another(case: FireCase) -> None:
    first, again, other = (map_case(case, "arrival-field", seed, FAST) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.arrival_h, again.arrival_h)
    np.testing.assert_array_equal(first.burned_probability, again.burned_probability)
    assert not np.array_equal(first.arrival_h, other.arrival_h)


def test_a_former_name_gives_the_method_it_named(case: FireCase) -> None:
    quick = PaperSettings(epochs=2)
    for former, name in FORMER_NAMES.items():
        before, now = map_case(case, former, 0, quick), map_case(case, name, 0, quick)
        np.testing.assert_array_equal(before.burned_probability, now.burned_probability)


def test_map_is_consistent_with_itself(case: FireCase) -> None:
    arrival = map_case(case, "arrival-field", 0, FAST)
    burned = np.isfinite(arrival.arrival_h)
    assert (arrival.q05_h[burned] <= arrival.arrival_h[burned]).all()
    assert (arrival.arrival_h[burned] <= arrival.q95_h[burned]).all()
    assert (arrival.sd_h[burned] > 0).all() and np.isnan(arrival.sd_h[~burned]).all()
    assert ((arrival.burned_probability >= 0) & (arrival.burned_probability <= 1)).all()
    assert arrival.arrival_h[burned].max() <= case.end_h
    assert not burned[arrival.evidence.distance_km > 4.0].any()


@pytest.mark.parametrize("zone_crs_corner", [(55, (400_000.0, 7_000_000.0)), (1, (300_000.0, 3_700_000.0))])
def test_elsewhere_on_earth_the_map_is_the_same(zone_crs_corner: tuple[int, tuple[float, float]]) -> None:
    zone, corner = zone_crs_corner
    fire = make_fire(TESTS[3], observations=1500, zone=zone, corner_m=corner)
    result = map_case(case_of(fire), "arrival-field", 0, FAST)
    assert score(result, truth_on(case_of(fire), fire)).f1 > 0.85


def test_burned_points_outline_a_fire_under_cloud() -> None:
    fire = make_fire(TESTS[4], observations=2000, tracks=40, cloudiness=0.85)
    with_points, _ = run(fire, "nearest-detection")
    blind, _ = run(replace(fire, burned_area=fire.burned_area.iloc[:0]), "nearest-detection")
    truth = np.isfinite(truth_on(case_of(fire), fire))
    found = (np.isfinite(with_points.arrival_h) & truth).sum()
    assert found > (np.isfinite(blind.arrival_h) & truth).sum()


def _only(case: FireCase, rows: np.ndarray) -> FireCase:
    return replace(case, looks=case.looks.take(rows))


def test_one_detection_gives_a_flagged_and_wide_map(case: FireCase) -> None:
    first = int(np.flatnonzero(case.looks.kind == FIRE)[5])
    arrival = map_case(_only(case, np.array([first])), "arrival-field", 0, FAST)
    assert {"one-detection", "no-negative-looks"} <= set(arrival.flags)
    burned = np.isfinite(arrival.arrival_h)
    assert 1 <= burned.sum() <= 20
    assert float(np.nanmin(arrival.sd_h)) > 12


def test_detections_at_one_instant_are_flagged(case: FireCase) -> None:
    instant = case.looks.fire.time_h[20]
    rows = np.flatnonzero((case.looks.kind == FIRE) & (case.looks.time_h == instant))
    assert "one-instant" in map_case(_only(case, rows), "arrival-field", 0, FAST).flags


def test_without_any_fire_nothing_burns_and_the_method_refuses(case: FireCase) -> None:
    none = _only(case, np.flatnonzero(case.looks.kind == NO_FIRE))
    empty = map_case(none, "arrival-field", 0, FAST)
    assert empty.flags == ("no-detection",) and np.isnan(empty.arrival_h).all()
    assert (empty.burned_probability == 0).all() and (empty.evidence.information == 1).any()
    with pytest.raises(DomainError) as error:
        infer_arrival(none.looks, none.grid, none.ignition, none.end_h)
    assert error.value.field == "detections"


def test_detections_before_the_reported_start_are_flagged(case: FireCase) -> None:
    late = replace(case, ignition=Ignition(float(case.looks.fire.time_h.min()) + 5.0))
    assert "detections-before-reported-start" in map_case(late, "nearest-detection", 0).flags


def test_unknown_method_and_look_after_the_end_are_refused(case: FireCase) -> None:
    with pytest.raises(DomainError) as error:
        infer_arrival(case.looks, case.grid, case.ignition, case.end_h, "svm2")
    assert error.value.field == "method" and all(name in error.value.accepted for name in METHODS)
    with pytest.raises(DomainError) as error:
        infer_arrival(case.looks, case.grid, case.ignition, 3.0)
    assert error.value.field == "end"


def test_undersampling_balances_the_classes() -> None:
    chosen = undersample(np.array([True] * 3 + [False] * 50), seeded(0))
    assert chosen.size == 6 and {0, 1, 2} <= set(chosen.tolist())


def test_bias_correction_moves_the_papers_network_by_a_constant(case: FireCase) -> None:
    plain = fit_paper(case.looks, PaperSettings(epochs=3), 0)
    moved = fit_paper(case.looks, PaperSettings(epochs=3, bias_correction=True), 0)
    x = np.linspace(-3, 3, 7)
    shift = moved.at(x, x)[0] - plain.at(x, x)[0]
    np.testing.assert_allclose(shift, shift[0, 0], atol=1e-6)
    fire = case.looks.fire
    assert abs(np.median(fire.time_h - moved.at(fire.x_km, fire.y_km)[0][0])) < 1e-3


def test_the_folded_network_gives_what_the_framework_gives(case: FireCase) -> None:
    fitted = fit_paper(case.looks, PaperSettings(epochs=3, bias_correction=True), 0)
    x, y = np.linspace(-4, 4, 9), np.linspace(3, -3, 9)
    hours, probability = fitted.at(x, y)
    plain_hours, plain_probability = fitted.folded()(x, y, np.full(9, fitted.source, np.int8))
    np.testing.assert_allclose(plain_hours, hours[0], atol=1e-3)
    np.testing.assert_allclose(plain_probability, probability[0], atol=1e-5)
