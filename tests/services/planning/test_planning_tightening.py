"""Odd-set inequalities: no set of whole images breaks one, halves do, and the bound they give holds and is tighter."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import sparse

from services.planning import tightening
from services.planning.milp import build_model
from services.planning.odd_sets import odd_set_rows, violated_odd_sets
from services.planning.solving import branch_and_bound, solve_relaxation
from services.planning.tightening import tightened_bound
from tests.services.planning.planning_cases import Case
from tests.services.planning.test_planning_reduction import problem_of, reduced

TRIANGLE = np.array([[1, 1, 0], [0, 1, 1], [1, 0, 1]], float)
"""Three images of which every two share a group."""


def model_of(case: Case):  # type: ignore[no-untyped-def]
    problem = problem_of(case)
    chunks, coverage = reduced(problem)
    return build_model(problem, chunks, coverage), chunks, coverage


def triangle_case() -> Case:
    """Room for two of a triangle's three images and one that sees a target of its own."""
    shots = [(k, "CYGFM01", float(2 * k), targets) for k, targets in enumerate([[1, 2], [2, 3], [1, 3], [4]])]
    rewards = dict.fromkeys((1, 2, 3, 4), ("prefire", 1.0))
    return Case(shots, rewards, [], craft={"storage_images": 2, "battery_initial_wh": 10.0})


def crossing_case(seed: int) -> Case:
    """Three satellites that store two of seven images each; an image sees two of twenty like targets."""
    rng = np.random.default_rng(seed)
    shots = [
        (7 * s + k, f"CYGFM0{s + 1}", float(2 * k), sorted(rng.choice(20, 2, replace=False).tolist()))
        for s in range(3) for k in range(7)
    ]  # fmt: skip
    rewards = {t: ("prefire", round(float(rng.uniform(0.8, 1.2)), 2)) for t in range(20)}
    craft = {"storage_images": 2, "battery_initial_wh": 10.0}
    return Case(shots, rewards, [], craft=craft)


@pytest.mark.parametrize("seed", range(8))
def test_no_set_of_whole_images_breaks_an_odd_set(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen = sparse.csr_array((rng.random((7, 9)) < 0.35).astype(float))
    members = rng.random((40, 9)) < 0.5
    sets = sparse.csr_array(members[members.sum(axis=1) % 2 == 1].astype(float))
    rows, high = odd_set_rows(seen, sets, 20)
    for choice in product((0.0, 1.0), repeat=7):
        point = np.zeros(20)
        point[:7], point[7:16] = choice, (seen.T @ np.array(choice)) > 0
        assert (rows @ point <= high + 1e-12).all()


def test_halves_of_a_triangle_break_it_by_half() -> None:
    seen = sparse.csr_array(TRIANGLE)
    half, full = np.full(3, 0.5), np.ones(3)
    sets = violated_odd_sets(seen, half, full)
    assert sets.toarray().tolist() == [[1, 1, 1]]
    rows, high = odd_set_rows(seen, sets, 6)
    assert rows @ np.concatenate([half, full]) - high == pytest.approx([0.5])
    assert violated_odd_sets(seen, np.array([1.0, 1.0, 0.0]), full).shape[0] == 0


def test_a_cycle_of_five_is_found_among_images_that_see_more() -> None:
    ring = np.zeros((6, 6))
    for i in range(5):
        ring[i, [i, (i + 1) % 5]] = 1
    ring[5, 5] = ring[0, 5] = 1
    sets = violated_odd_sets(sparse.csr_array(ring), np.append(np.full(5, 0.5), 0.5), np.ones(6))
    assert [1, 1, 1, 1, 1, 0] in sets.toarray().tolist()


def test_a_triangle_and_a_single_are_proven_to_the_optimum() -> None:
    """Two of four images: all three groups of the triangle, or two of them and the single; halves would give 3.5."""
    model, chunks, coverage = model_of(triangle_case())
    relaxation = solve_relaxation(model, 10.0)
    assert relaxation.bound == pytest.approx(3.5, abs=1e-4)
    heard: list[float] = []
    bound, cut = tightened_bound(model, chunks, coverage, relaxation, 3, lambda: 10.0, heard.append)
    assert bound == pytest.approx(3.0, abs=1e-3) and bound >= 3.0 and not cut
    assert min(heard) >= bound


@pytest.mark.parametrize("seed", range(10))
def test_the_tightened_bound_lies_between_optimum_and_relaxation(seed: int) -> None:
    model, chunks, coverage = model_of(crossing_case(seed))
    relaxation = solve_relaxation(model, 10.0)
    exact = branch_and_bound(model, np.arange(len(model.cost)) < model.images, 0.0, 1000, 10.0)
    optimum = float(model.cost[model.images :][: model.groups] @ _covered(coverage, exact.images))
    bound, _ = tightened_bound(model, chunks, coverage, relaxation, 6, lambda: 10.0)
    assert optimum - 1e-6 <= bound <= relaxation.bound


def test_tightening_takes_much_of_the_gap_of_crossing_images() -> None:
    gaps = np.zeros(2)
    for seed in range(8):
        model, chunks, coverage = model_of(crossing_case(seed))
        relaxation = solve_relaxation(model, 10.0)
        exact = branch_and_bound(model, np.arange(len(model.cost)) < model.images, 0.0, 1000, 10.0)
        bound, _ = tightened_bound(model, chunks, coverage, relaxation, 6, lambda: 10.0)
        gaps += np.array([bound, relaxation.bound]) - exact.bound
    assert gaps[1] > 0.2 and gaps[0] < 0.5 * gaps[1]


def test_without_time_the_relaxation_stands_and_the_cut_is_told() -> None:
    model, chunks, coverage = model_of(crossing_case(0))
    relaxation = solve_relaxation(model, 10.0)
    assert tightened_bound(model, chunks, coverage, relaxation, 6, lambda: 0.0) == (relaxation.bound, True)
    assert tightened_bound(model, chunks, coverage, relaxation, 0, lambda: 10.0) == (relaxation.bound, False)


def _covered(coverage, images):  # type: ignore[no-untyped-def]
    return (coverage.matrix().T @ (images > 0.5)) > 0.5


def test_an_interior_point_that_time_cut_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    model, chunks, coverage = model_of(triangle_case())
    relaxation = solve_relaxation(model, 10.0)
    assert not relaxation.time_limited
    monkeypatch.setattr(
        tightening, "solve_relaxation", lambda tight, _: replace(solve_relaxation(tight, 10.0), time_limited=True)
    )
    bound, cut = tightened_bound(model, chunks, coverage, relaxation, 3, lambda: 10.0)
    assert cut and 3.0 <= bound < relaxation.bound
