"""The exact timeline of a set of images: what it keeps of one that does not fit, and how large its programs get."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.planning import fitting
from services.planning.data_cycles import build_chunks
from services.planning.downlinks import emit_timeline
from services.planning.fitting import with_offers
from services.planning.greedy import complete
from services.planning.milp import DataCycleModel
from services.planning.problem import BoolArray, PlanningProblem
from services.planning.request import Request, build
from services.planning.solving import Solution, branch_and_bound
from tests.services.planning.planning_cases import Case, exhaustive_optimum, random_case


def _problem(case: Case) -> PlanningProblem:
    return build(Request(case.tables, case.spacecraft))


def _none(problem: PlanningProblem) -> BoolArray:
    return np.zeros(len(problem.targets.value), bool)


@pytest.mark.parametrize("seed", [24, 78, 112, 180, 187, 225, 256, 301, 303, 322, 336, 343, 388])
def test_of_images_that_do_not_fit_the_most_valuable_part_is_kept(seed: int) -> None:
    case = random_case(seed, satellites=1 + seed % 3)
    problem = _problem(case)
    timeline = emit_timeline(problem, np.arange(len(problem.images)), _none(problem))
    assert problem.objective(timeline.images) == pytest.approx(exhaustive_optimum(case))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), satellites=st.integers(1, 3), images=st.integers(2, 16))
def test_what_completes_a_timeline_fits_beside_it(seed: int, satellites: int, images: int) -> None:
    problem = _problem(random_case(seed, satellites, images))
    some = np.arange(0, len(problem.images), 2)
    timeline = emit_timeline(problem, some, _none(problem))
    more = complete(problem, build_chunks(problem), timeline.images, timeline.downlink)
    assert np.isin(timeline.images, more).all()
    assert not len(emit_timeline(problem, more, _none(problem)).dropped)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), share=st.floats(0, 1))
def test_offers_never_cost_reward_and_keep_required_targets(seed: int, share: float) -> None:
    problem = _problem(random_case(seed, 3, 16))
    some = np.flatnonzero(np.random.default_rng(seed).random(len(problem.images)) < share)
    timeline = emit_timeline(problem, some, _none(problem))
    required = problem.covered_targets(timeline.images) & problem.targets.active
    chunks = build_chunks(problem, timeline.cuts)
    better, _ = with_offers(problem, chunks, timeline.images, required)
    assert problem.objective(better) >= problem.objective(timeline.images)
    assert problem.covered_targets(better)[required].all()


def _crowded(bystanders: int, shared: bool) -> Case:
    """One satellite asked for four images with room for two; others, at its station or their own, that fit."""
    images, contacts = [(second, "SAT000", float(second), [second]) for second in range(4)], []
    for number in range(bystanders + 1):
        name, station = f"SAT{number:03d}", "hawaii" if shared else f"station{number:03d}"
        contacts.append((name, station, 6.0, 9.0))
        if number:
            images += [(10 * number + k, name, float(k), [10 * number + k]) for k in range(2)]
    rewards = {target: ("prefire", 1.0 + target % 7) for *_, covered in images for target in covered}
    return Case(images, rewards, contacts, craft={"storage_images": 2})


def _choices(case: Case, monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Whole columns and target groups of every program that chooses images while a timeline is emitted."""
    sizes = []

    def spied(model: DataCycleModel, whole: BoolArray, *limits: float) -> Solution:
        sizes.append((int(whole.sum()), model.groups))
        return branch_and_bound(model, whole, *limits)

    monkeypatch.setattr(fitting, "branch_and_bound", spied)
    problem = _problem(case)
    everything = np.arange(len(problem.images))
    timeline = emit_timeline(problem, everything, _none(problem))
    assert problem.images.image_id[timeline.dropped].tolist() == [0, 1]
    return sizes


def test_programs_do_not_grow_with_satellites_that_are_not_involved(monkeypatch: pytest.MonkeyPatch) -> None:
    few, many = (_choices(_crowded(count, shared=False), monkeypatch) for count in (1, 40))
    assert few == many
    assert max(few) == (4, 4)


def test_programs_are_limited_where_all_satellites_share_a_station(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "FREED_IMAGES", 12)
    sizes = _choices(_crowded(40, shared=True), monkeypatch)
    assert max(sizes) == (12, 12)
