"""Equal plans go early: images move to earlier chances, but never at the cost of reward or of a resource."""

from __future__ import annotations

import numpy as np
import pytest

from services.planning.data_cycles import build_chunks
from services.planning.early import earlier_images, first_looks
from services.planning.operations import judge, make_plan
from tests.services.planning.planning_cases import Case, exhaustive_optimum, random_case
from tests.services.planning.test_planning_reduction import problem_of

REWARDS = {1: ("active", 1.0), 2: ("prefire", 1.0), 3: ("prefire", 0.5)}
SHOTS = [(0, "CYGFM01", 1, [1]), (1, "CYGFM01", 2, [1, 2]), (2, "CYGFM01", 10, [1, 2]), (3, "CYGFM01", 12, [1, 2, 3])]


def planned(images: list[int], storage: int) -> list[int]:
    problem = problem_of(Case(SHOTS, REWARDS, [], craft={"storage_images": storage, "battery_initial_wh": 10.0}))
    nothing = np.full((1, problem.horizon_s), -1, np.int16)
    return earlier_images(problem, build_chunks(problem), np.array(images), nothing).tolist()


def test_an_image_moves_to_the_earliest_that_covers_as_much() -> None:
    assert planned([2], 1) == [1]


def test_images_that_gain_nothing_go_and_what_only_a_late_one_covers_stays() -> None:
    assert planned([1, 2], 2) == [0, 1]  # room for one more: an earlier look at the active target
    assert planned([3], 1) == [3]
    assert planned([3], 2) == [0, 3]


@pytest.mark.parametrize("seed", range(80, 92))
def test_every_target_stays_and_the_first_looks_come_no_later(seed: int) -> None:
    case = random_case(seed, 2, 12)
    made = make_plan(case.tables, case.spacecraft)
    assert judge(made.schedule, case.tables, case.spacecraft).valid
    assert made.plan.objective <= exhaustive_optimum(case) + 1e-9
    problem, timeline = made.problem, made.plan.timeline
    again = earlier_images(problem, build_chunks(problem), timeline.images, timeline.downlink)
    before, after = (first_looks(problem, images) for images in (timeline.images, again))
    matters = problem.targets.active & (before >= 0)
    assert ((after >= 0) | (before < 0) | (problem.targets.value == 0)).all()
    assert (after[matters] <= before[matters]).all()
