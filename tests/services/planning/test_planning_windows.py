"""The program over windows: its bound against all plans of recordings, and what it says where it was cut."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.planning.bugs import PlanningBugError
from services.planning.operations import MadePlan, make_plan
from services.planning.options.rules import OperationRules
from services.planning.planner import Options
from services.planning.request import Request, build
from services.planning.sequencing.recording_program import RecordingProgram
from services.planning.sequencing.second_model import SecondModel
from services.planning.solving import Solution, branch_and_bound
from tests.services.planning.planning_cases import Case

PROGRAM = "services.planning.sequencing.recording_program"
RECORDED = "services.planning.sequencing.recorded"
LARGEST = "services.planning.sequencing.sequence.LARGEST_CELLS"
PLENTY = {"battery_initial_wh": 10.0, "horizon_s": 60}


def islands(count: int, length: int, kinds: list[str], apart: int, gain: list[float], **craft: object) -> Case:
    """``count`` runs of ``length`` images, ``apart`` seconds from one to the next; each image sees a target."""
    images = [(10 * i + k, "CYGFM01", 2.0 + apart * i + k, [10 * i + k]) for i in range(count) for k in range(length)]
    rewards = {n: (kinds[n // 10], gain[n // 10]) for n, *_ in images}
    return Case(images, rewards, [], craft={**PLENTY, **craft})


def planned(case: Case, rules: OperationRules, work: float = 0.2, mandatory: str = "auto") -> MadePlan:
    options = Options(mip_gap=0.0, work_limit=work, active_mandatory=mandatory)
    return make_plan(case.tables, case.spacecraft, rules=rules, price=False, options=options)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6), least=st.integers(2, 5), storage=st.integers(4, 40), active=st.booleans(),
    contact=st.booleans(), satellites=st.integers(1, 2),
)  # fmt: skip
def test_no_plan_beats_the_bound_where_a_chunk_holds_several_recordings(
    seed: int, least: int, storage: int, active: bool, contact: bool, satellites: int
) -> None:
    """Islands of alike targets in chunks of half a minute: the bound of the windows alone, against exact optima."""
    rng = np.random.default_rng(seed)
    begin = np.arange(1, 56, 6) + rng.integers(0, 3, 10)
    images = [
        (100 * s + 10 * i + k, f"CYGFM0{s + 1}", float(t + k), [10 * i + k])
        for s in range(satellites) for i, t in enumerate(begin) for k in range(int(rng.integers(1, 4)))
    ]  # fmt: skip
    rewards = {n: ("active" if active and n == 0 else "prefire", 1.0 + n % 20 // 10) for _, _, _, (n,) in images}
    contacts = [("CYGFM01", "hawaii", 30.0, 36.0)] if contact else []
    case = Case(images, rewards, contacts, craft={**PLENTY, "storage_images": storage})
    problem = build(Request(case.tables, case.spacecraft))
    none = np.zeros(len(problem.targets.value), bool)
    chosen = RecordingProgram(problem, least).solve(none, none, 1e-6, lambda: 10.0)
    exact = SecondModel(problem, OperationRules(min_collect_s=least), none).solve(30.0)
    assert chosen is not None
    assert exact is not None
    own = problem.images
    taken = np.flatnonzero(exact.recording[own.satellite, own.second] == own.pointing_of())
    assert problem.objective(taken) <= chosen.bound + 1e-6


def test_windows_side_by_side_in_a_chunk_all_count() -> None:
    """Three islands alike in one chunk, storage for all: one window stands for three."""
    case = islands(3, 3, ["prefire"] * 3, 20, [1.0] * 3, storage_images=30)
    problem = build(Request(case.tables, case.spacecraft))
    program, none = RecordingProgram(problem, 3), np.zeros(9, bool)
    chosen = program.solve(none, none, 1e-6, lambda: 10.0)
    assert chosen is not None
    assert program.windows is not None
    assert chosen.recording is not None
    assert problem.objective(np.flatnonzero(chosen.recording[0, problem.images.second] == 0)) == pytest.approx(9.0)
    assert chosen.bound >= 9.0
    assert (program.windows.times == 20).all()


@pytest.mark.parametrize("rules", [OperationRules(min_collect_s=3), OperationRules(max_commands_per_day=2)])
def test_bound_holds_for_plans_that_give_up_active_targets(
    rules: OperationRules, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three active targets of hardly any worth: all are met without the rules (5.7), not with them (10.2 at best)."""
    near = [(k, "CYGFM01", float(5 + 20 * k), [k]) for k in range(3)]
    far = islands(5, 3, ["prefire"] * 5, 50, [1.0 + 0.2 * i for i in range(5)])
    images = near + [(n + 100, s, t + 198.0, [n + 100]) for n, s, t, _ in far.images]
    rewards = dict.fromkeys(range(3), ("active", 0.01)) | {n + 100: reward for n, reward in far.rewards.items()}
    case = Case(images, rewards, [], craft={**PLENTY, "storage_images": 6, "horizon_s": 1000})
    short = planned(case, rules, 1e-4)
    best = planned(case, rules, 1.0, mandatory="false")
    assert best.plan.objective == pytest.approx(10.2)
    assert not short.plan.mandatory
    assert short.plan.bound >= best.plan.objective - 1e-6


def test_what_time_cut_is_told_though_nothing_was_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The count proves that two of three active targets cannot be met; then the programs are cut before a plan."""
    case = islands(3, 1, ["active"] * 3, 20, [1.0] * 3, storage_images=3)
    calls: list[float] = []

    def cut(model, whole, gap, nodes, seconds):  # type: ignore[no-untyped-def]
        calls.append(gap)
        if len(calls) == 1:
            return branch_and_bound(model, whole, gap, nodes, seconds)
        nothing = np.zeros(model.images)
        return Solution(nothing, np.zeros(model.links), 1e9, nothing, feasible=False, time_limited=True)

    monkeypatch.setattr(f"{PROGRAM}.branch_and_bound", cut)
    monkeypatch.setattr(LARGEST, 0)
    made = planned(case, OperationRules(min_collect_s=3))
    assert len(calls) > 1
    assert made.plan.time_limited
    assert made.plan.mandatory_possible is False
    assert made.plan.mandatory_most == 1


def test_prices_that_time_cut_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    case = islands(3, 3, ["prefire"] * 3, 20, [1.0] * 3, storage_images=6)
    program = RecordingProgram(build(Request(case.tables, case.spacecraft)), 3)
    assert not program.settle_prices(lambda: 10.0)

    def cut(model, seconds):  # type: ignore[no-untyped-def]
        nothing = np.zeros(model.images)
        return Solution(nothing, np.zeros(model.links), 1e9, nothing, feasible=False, time_limited=True)

    monkeypatch.setattr(f"{PROGRAM}.solve_relaxation", cut)
    assert program.settle_prices(lambda: 10.0)


def test_a_plan_worth_more_than_its_bound_is_a_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    case = islands(3, 3, ["prefire"] * 3, 20, [1.0] * 3, storage_images=30)
    monkeypatch.setattr(LARGEST, 0)
    monkeypatch.setattr(f"{RECORDED}._bound", lambda *_: (8.9, "this case"))
    with pytest.raises(PlanningBugError, match=r"9\.0, more than the 8\.9 proven for this case"):
        planned(case, OperationRules(min_collect_s=3))


def test_no_targets_no_complaint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LARGEST, 0)
    case = Case([], {}, [("CYGFM01", "hawaii", 10.0, 30.0)], craft=PLENTY)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert planned(case, OperationRules(min_collect_s=3)).plan.objective == 0.0
