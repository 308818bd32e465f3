"""Reduction and bounds: what is merged or dropped never changes the optimum, and multipliers always bound it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from services.planning import guidance
from services.planning.building import build_problem
from services.planning.coverage import reduce_coverage
from services.planning.data_cycles import build_chunks
from services.planning.milp import build_model, lagrangian_bound
from services.planning.problem import PlanningProblem
from services.planning.quotas import whole_quotas
from services.planning.search.annealing import Search, anneal
from services.planning.search.halves import improve_halves
from services.planning.search.kernels import satellite_ok
from services.planning.search.space import allot_downlinks, construct, energy_binds, search_space
from services.planning.solving import branch_and_bound, solve_relaxation
from services.planning.spacecraft_limits import satellite_limits
from services.planning.subgradient import (
    MOST_ROUNDS,
    ROUNDS,
    ROUNDS_WORK,
    STEPS_PER_ROUND,
    guided_multipliers,
    rounds_for,
)
from tests.services.planning.planning_cases import Case, exhaustive_optimum, random_case


def problem_of(case: Case) -> PlanningProblem:
    names = {s for _, s, _, _ in case.images} | {c[0] for c in case.contacts}
    craft = case.spacecraft
    import pandas as pd

    start = pd.Timestamp(craft.horizon_start).tz_convert("UTC")
    return build_problem(**case.tables, spacecraft=satellite_limits(craft, names), horizon_start=start,
                         horizon_s=craft.horizon_s)  # fmt: skip


def reduced(problem: PlanningProblem):  # type: ignore[no-untyped-def]
    chunks, targets = build_chunks(problem), len(problem.targets.value)
    everything = np.arange(len(problem.images))
    return chunks, reduce_coverage(problem, chunks, everything, np.ones(targets, bool), np.zeros(targets, bool))


def test_targets_seen_by_the_same_images_become_one() -> None:
    case = Case(
        [(0, "CYGFM01", 1, [1, 2, 3]), (1, "CYGFM01", 5, [1, 2])],
        {1: ("prefire", 1.0), 2: ("active", 0.5), 3: ("prefire", 2.0), 4: ("prefire", 9.0)}, [],
    )  # fmt: skip
    problem = problem_of(case)
    _, coverage = reduced(problem)
    assert sorted(coverage.value.tolist()) == [2.0, 6.0]
    assert coverage.group_of[0] == coverage.group_of[1] != coverage.group_of[2]
    assert coverage.group_of[3] == -1


def test_a_subset_in_the_same_chunk_is_dropped_and_across_chunks_kept() -> None:
    shots = [(0, "CYGFM01", 1, [1]), (1, "CYGFM01", 2, [1, 2]), (2, "CYGFM01", 9, [1])]
    rewards = {1: ("prefire", 1.0), 2: ("prefire", 1.0)}
    problem = problem_of(Case(shots, rewards, [("CYGFM01", "hawaii", 4, 6)]))
    _, coverage = reduced(problem)
    assert problem.images.image_id[coverage.image].tolist() == [1, 2]


@pytest.mark.parametrize("seed", range(6))
def test_any_multipliers_give_a_bound(seed: int) -> None:
    case = random_case(seed)
    best = exhaustive_optimum(case)
    problem = problem_of(case)
    chunks, coverage = reduced(problem)
    model = build_model(problem, chunks, coverage)
    rng = np.random.default_rng(seed)
    for scale in (0.0, 0.1, 1.0, 10.0):
        bound, _ = lagrangian_bound(model, scale * rng.normal(size=len(model.row_low)))
        assert bound >= best - 1e-6
    relaxation = solve_relaxation(model, 10.0)
    whole = np.arange(len(model.cost)) < model.images
    exact = branch_and_bound(model, whole, 0.0, 1000, 10.0)
    assert relaxation.bound >= exact.bound - 1e-6 >= best - 1e-5


@pytest.mark.parametrize("seed", range(6))
def test_whole_quotas_tighten_the_bound_and_never_cut_a_plan_off(seed: int) -> None:
    case = random_case(seed)
    problem = problem_of(case)
    chunks, coverage = reduced(problem)
    model = build_model(problem, chunks, coverage)
    relaxation = solve_relaxation(model, 10.0)
    quotas = whole_quotas(model, chunks, coverage, relaxation, guide=False, time_limit_s=10.0)
    assert quotas.feasible
    assert exhaustive_optimum(case) - 1e-6 <= quotas.bound <= relaxation.bound + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_averaged_subgradients_bound_every_plan(seed: int) -> None:
    case = random_case(seed)
    chunks, coverage = reduced(problem_of(case))
    found = guided_multipliers(build_model(problem_of(case), chunks, coverage), chunks, coverage)
    best = exhaustive_optimum(case)
    assert best - 1e-6 <= found.bound <= coverage.value.sum() + 1e-6
    again = guided_multipliers(build_model(problem_of(case), chunks, coverage), chunks, coverage)
    assert found.bound == again.bound
    assert np.array_equal(found.images, again.images)


@pytest.mark.parametrize("seed", range(4))
def test_guidance_of_large_cases_bounds_every_plan(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guidance, "LARGE_ENTRIES", 0)
    case = random_case(seed)
    problem = problem_of(case)
    chunks, coverage = reduced(problem)
    found = guidance.rough_guidance(build_model(problem, chunks, coverage), chunks, coverage, lambda: 1000.0)
    assert exhaustive_optimum(case) - 1e-6 <= found.bound <= found.relaxation.bound
    assert not found.time_limited


def test_rounds_fall_with_size_between_their_limits() -> None:
    _, coverage = reduced(problem_of(random_case(1)))
    sizes = (0, 10**5, 6 * 10**5, 10**6, 10**7)
    rounds = [rounds_for(replace(coverage, group=np.zeros(size, np.int64))) for size in sizes]
    assert rounds == sorted(rounds, reverse=True)
    assert (rounds[0], rounds[-1]) == (MOST_ROUNDS, ROUNDS)
    assert rounds[2] * STEPS_PER_ROUND * sizes[2] <= ROUNDS_WORK


@pytest.mark.parametrize("seed", range(6))
def test_annealing_never_loses_and_repeats_exactly(seed: int) -> None:
    problem = problem_of(random_case(seed, 3, 24, tight=False))
    chunks, coverage = reduced(problem)
    links = np.zeros(len(chunks.link_chunk))
    allotment = allot_downlinks(chunks, links, spare=not energy_binds(problem, chunks))
    space, order = search_space(problem, chunks, coverage, allotment.per_chunk())
    start = construct(space, np.arange(len(space.chunk)))
    first, again = (anneal(space, allotment, start, 250_000, 1.0, 0.05) for _ in range(2))
    assert np.array_equal(first.chosen, again.chosen)
    assert first.value >= problem.objective(coverage.image[order][start]) - 1e-9
    assert first.value == pytest.approx(problem.objective(coverage.image[order][first.chosen]))


def test_a_cooling_that_does_not_fit_the_time_left_is_hurried_and_says_so() -> None:
    problem = problem_of(random_case(1, 3, 24, tight=False))
    chunks, coverage = reduced(problem)
    allotment = allot_downlinks(chunks, np.zeros(len(chunks.link_chunk)), spare=True)
    space, _ = search_space(problem, chunks, coverage, allotment.per_chunk())
    start = construct(space, np.arange(len(space.chunk)))
    seconds = iter(range(8, -100, -1))  # a clock that shows a second less at every look
    made = anneal(space, allotment, start, 10_000_000, 1.0, 0.05, left=lambda: float(next(seconds)))
    assert made.time_limited
    assert 500_000 <= made.moves <= 900_000
    assert made.value >= space.objective(start) - 1e-9
    in_time = anneal(space, allotment, start, 300_000, 1.0, 0.05, left=lambda: 1e6)
    assert not in_time.time_limited and in_time.moves == 300_000


@pytest.mark.parametrize("seed", range(4))
def test_exact_halves_only_gain_and_leave_every_chunk_its_count(seed: int) -> None:
    problem = problem_of(random_case(seed, 3, 30, tight=False))
    chunks, coverage = reduced(problem)
    allotment = allot_downlinks(chunks, np.zeros(len(chunks.link_chunk)), spare=True)
    space, _ = search_space(problem, chunks, coverage, allotment.per_chunk())
    start = construct(space, np.arange(len(space.chunk))[::-1].copy())
    better, cut = improve_halves(space, start, 6, lambda: 30.0, lambda done, chosen: False)
    again, _ = improve_halves(space, start, 6, lambda: 30.0, lambda done, chosen: False)
    assert not cut and np.array_equal(better, again)
    assert space.objective(better) >= space.objective(start)
    count = [np.bincount(space.chunk[chosen], minlength=len(chunks)) for chosen in (start, better)]
    assert (count[1] <= count[0]).all()
    assert improve_halves(space, start, 6, lambda: 30.0, lambda done, chosen: True) == (pytest.approx(start), True)


@pytest.mark.parametrize("seed", range(8))
def test_annealing_keeps_counters_and_resources(seed: int) -> None:
    """After many steps the incremental counters are what a recount gives, and stations hold what they have."""
    problem = problem_of(random_case(seed, 3, 24))
    chunks, coverage = reduced(problem)
    allotment = allot_downlinks(chunks, chunks.cell_free_s[chunks.link_cell] / 3.0, spare=False)
    space, _ = search_space(problem, chunks, coverage, allotment.per_chunk())
    search = Search(space, allotment, construct(space, np.arange(len(space.chunk))), seed)
    search.run(20_000, 1.0, 0.05)
    kept = {name: getattr(search, name).copy() for name in ("cover", "count", "open_value", "sole_value")}
    assert search.totals[0] == pytest.approx(search._count())
    for name, value in kept.items():
        assert getattr(search, name) == pytest.approx(value, abs=1e-9), name
    used = np.bincount(chunks.link_cell, search.link_s, minlength=len(chunks.cell_free_s))
    assert (search.link_s >= 0).all()
    assert (used <= chunks.cell_free_s).all()
    assert search.numbers[:, 5] == pytest.approx(np.bincount(chunks.link_chunk, search.link_s, minlength=len(chunks)))
    for s in range(len(problem.satellites)):
        assert satellite_ok(s, search.count, space.chunk_offset, search.numbers, space.limits)


def test_shared_cuts_make_station_cells_equal() -> None:
    problem = problem_of(replace(random_case(3), contacts=[("CYGFM01", "hawaii", 2, 8), ("CYGFM02", "hawaii", 5, 12)]))
    chunks = build_chunks(problem)
    cells = [
        sorted(map(int, chunks.start_s[chunks.link_chunk[chunks.link_cell == c]]))
        for c in range(len(chunks.cell_free_s))
    ]
    assert [5, 5] in cells
    assert all(len(set(starts)) == 1 for starts in cells)
