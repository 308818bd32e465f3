"""Recordings, mode switches, command budgets and slews: against every possible sequence of tiny cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.planning.data_cycles import build_chunks
from services.planning.operations import judge, make_plan
from services.planning.options.rules import OperationRules
from services.planning.planner import Options
from services.planning.request import Request, build
from services.planning.sequencing.windows import recording_windows
from tests.services.planning.planning_brute_force import best_sequence
from tests.services.planning.planning_cases import Case, random_case

EXACT = Options(mip_gap=0.0, active_mandatory="false")
RULES = {
    "min_collect_s": OperationRules(min_collect_s=2),
    "mode_switch_s": OperationRules(mode_switch_s=2),
    "max_commands_per_day": OperationRules(max_commands_per_day=2),
    "all": OperationRules(min_collect_s=2, mode_switch_s=1, max_commands_per_day=3),
}


def small(seed: int, satellites: int = 1, pointings: int = 1, horizon: int = 11) -> Case:
    """A random case of at most 11 seconds; with ``pointings`` each image is taken under one of them."""
    rng = np.random.default_rng(seed)
    case = random_case(seed, satellites, 8 * satellites, tight=bool(seed % 2))
    shots = [shot for shot in case.images if shot[2] < horizon]
    if pointings > 1:  # every second image once more, elsewhere
        shots += [(100 + i, s, t, [int(rng.integers(5))]) for i, s, t, _ in shots[::2]]
    contacts = [(s, g, a, min(b, horizon)) for s, g, a, b in case.contacts if a < horizon - 1]
    held = {i: f"side-{int(rng.integers(pointings)) if i < 100 else 0}" for i, *_ in shots} if pointings > 1 else {}
    for i, s, t, _ in shots if pointings > 1 else []:
        twin = [j for j, s2, t2, _ in shots if (s2, t2) == (s, t) and j != i]
        if twin and held[i] == held[twin[0]]:
            held[max(i, twin[0])] = "side-1" if held[i] == "side-0" else "side-0"
    names = [f"side-{k}" for k in range(pointings)]
    slew = {a: {b: int(rng.integers(0, 4)) for b in names if a != b} for a in names} if pointings > 1 else None
    return replace(
        case, images=shots, contacts=contacts, pointing=held, craft={**case.craft, "horizon_s": horizon, "slew": slew}
    )


@pytest.mark.parametrize("seed", range(300, 308))
@pytest.mark.parametrize("name", RULES)
def test_options_reach_the_best_of_all_sequences(seed: int, name: str) -> None:
    case = small(seed)
    best = best_sequence(case, RULES[name])
    made = make_plan(case.tables, case.spacecraft, options=EXACT, rules=RULES[name], price=False)
    assert made.plan.objective == pytest.approx(best, abs=1e-6)
    assert made.plan.bound >= best - 1e-6
    assert judge(made.schedule, case.tables, case.spacecraft, rules=RULES[name]).valid


@pytest.mark.parametrize("seed", range(400, 412))
def test_slews_reach_the_best_of_all_sequences(seed: int) -> None:
    case = small(seed, pointings=2 + seed % 2)
    best = best_sequence(case, OperationRules())
    made = make_plan(case.tables, case.spacecraft, options=EXACT)
    assert made.plan.objective == pytest.approx(best, abs=1e-6)
    collects = made.schedule[made.schedule["command"] == "collect"]
    assert collects["pointing"].tolist() == [case.pointing[i] for i in collects["image_id"]]


@pytest.mark.parametrize("seed", range(500, 504))
def test_two_satellites_share_a_station_under_all_options(seed: int) -> None:
    case = small(seed, satellites=2, horizon=8)
    best = best_sequence(case, RULES["all"])
    made = make_plan(case.tables, case.spacecraft, options=EXACT, rules=RULES["all"], price=False)
    assert made.plan.objective == pytest.approx(best, abs=1e-6)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    seed=st.integers(2000, 10**6), least=st.integers(1, 4), switch=st.integers(0, 3),
    most=st.one_of(st.none(), st.integers(0, 5)), pointings=st.integers(1, 3),
)  # fmt: skip
def test_search_keeps_every_rule_and_never_beats_the_exact_plan(
    seed: int, least: int, switch: int, most: int | None, pointings: int
) -> None:
    """The search for large cases, made to plan small ones: its plans pass the replay and stay below the optimum."""
    case = small(seed, satellites=2, pointings=pointings)
    rules = OperationRules(min_collect_s=least, mode_switch_s=switch, max_commands_per_day=most)
    exact = make_plan(case.tables, case.spacecraft, options=EXACT, rules=rules, price=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("services.planning.sequencing.sequence.LARGEST_CELLS", 0)
        quick = Options(mip_gap=0.0, active_mandatory="false", work_limit=0.2)
        found = make_plan(case.tables, case.spacecraft, options=quick, rules=rules, price=False)
    assert found.plan.objective <= exact.plan.bound + 1e-6
    assert exact.plan.objective <= found.plan.bound + 1e-6, "what windows bound is any plan of recordings"


@pytest.mark.parametrize(("seed", "possible"), [(600, True), (601, False)])
def test_only_a_proof_says_that_mandatory_targets_cannot_be_met(
    seed: int, possible: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The exact program knows whether recordings leave room for all; a search that misses one does not know."""
    case, rules = small(seed), OperationRules(min_collect_s=3, max_commands_per_day=1)
    told = [make_plan(case.tables, case.spacecraft, rules=rules, price=False).report["active_mandatory"]]
    monkeypatch.setattr("services.planning.sequencing.sequence.LARGEST_CELLS", 0)
    told.append(make_plan(case.tables, case.spacecraft, rules=rules, price=False).report["active_mandatory"])
    assert [one["held"] for one in told] == [possible, possible]
    assert [one["possible"] for one in told] == ([True, True] if possible else [False, None])


@pytest.mark.parametrize("seed", range(700, 708, 2))
def test_windows_hold_what_their_seconds_see(seed: int) -> None:
    """Against sets of seconds: dear targets exactly, the worth of the others at least; and one for every long take."""
    case, least = small(seed, satellites=2, pointings=1 + seed // 2 % 2), 3
    problem = build(Request(case.tables, case.spacecraft))
    own, dear = problem.images, np.flatnonzero(problem.targets.active)
    price = np.where(problem.targets.active, 0.0, problem.targets.value)
    windows = recording_windows(problem, build_chunks(problem), least, dear, price, energy=True, most=1000)
    assert windows is not None
    best: dict[tuple[int, ...], float] = {}
    for i in range(len(windows)):
        seconds = range(windows.second[i], windows.second[i] + windows.length[i])
        inside = np.isin(own.second, seconds) & (own.satellite == windows.satellite[i])
        inside &= own.pointing_of() == windows.pointing[i]
        seen = {int(t) for image in np.flatnonzero(inside) for t in own.covered(int(image))}
        assert least <= windows.length[i] < 2 * least
        assert problem.commandable[windows.satellite[i], seconds].all()
        assert set(dear[windows.dear[[i]].indices].tolist()) == seen & set(dear.tolist())
        assert windows.worth[i] >= price[sorted(seen)].sum() - 1e-9
        best[tuple(sorted(seen))] = windows.worth[i]
    assert len(best) > 1


def test_windows_prove_that_storage_has_no_room_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two active targets too far apart for one recording, and storage for one: known without a look at seconds."""
    case = Case(
        [(0, "CYGFM01", 1, [1]), (1, "CYGFM01", 7, [2]), (2, "CYGFM01", 8, [3])],
        {1: ("active", 1.0), 2: ("active", 0.9), 3: ("prefire", 2.0)}, [("CYGFM01", "hawaii", 10, 11)],
        craft={"battery_initial_wh": 10.0, "storage_images": 5, "horizon_s": 11},
    )  # fmt: skip
    rules = OperationRules(min_collect_s=3)
    exact = make_plan(case.tables, case.spacecraft, rules=rules, price=False)
    monkeypatch.setattr("services.planning.sequencing.sequence.LARGEST_CELLS", 0)
    found = make_plan(case.tables, case.spacecraft, rules=rules, price=False)
    for made in (exact, found):
        assert made.plan.mandatory_possible is False
        assert made.plan.objective == pytest.approx(11.0)
        assert made.plan.bound == pytest.approx(11.0)
        assert made.report["bound_of"] == "this case"
        assert made.report["active_mandatory"]["dropping"]["active_observed_at_most"] == 1


@pytest.mark.parametrize("seed", range(800, 806))
def test_dropping_the_constraint_is_priced_under_the_same_rules(seed: int) -> None:
    """Against all sequences: as many active targets as recordings leave room for, then the most reward."""
    case, rules, bonus = small(seed), RULES["all"], 1000.0
    made = make_plan(case.tables, case.spacecraft, options=Options(mip_gap=0.0), rules=rules, price=False)
    price = made.report["active_mandatory"]["dropping"]
    favoured = {t: (kind, r + bonus * (kind == "active")) for t, (kind, r) in case.rewards.items()}
    best = best_sequence(replace(case, rewards=favoured), rules)
    most = int(best // (10 * bonus))
    observed = made.report["targets"]["active"]["planned"]
    if price is None:
        assert observed == most
    else:
        assert (price["active_observed"], price["active_observed_at_most"]) == (observed, most)
        assert price["reward_with_most_active"] == pytest.approx(best - 10 * bonus * most)


@pytest.mark.parametrize("seed", range(600, 606))
def test_the_previous_plan_may_break_what_new_commands_must_keep(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rules switched on in mid-plan bind new commands only; frozen recordings stay however short they are."""
    from tests.services.planning.planning_cases import at

    case = replace(small(seed, satellites=2, horizon=11), eclipses=[])
    previous = make_plan(case.tables, case.spacecraft).schedule
    rules = OperationRules(min_collect_s=3, mode_switch_s=2, max_commands_per_day=3, frozen_until=at(5))
    made = make_plan(case.tables, case.spacecraft, previous=previous, rules=rules, price=False)
    verdict = judge(made.schedule, case.tables, case.spacecraft, previous=previous, rules=rules)
    assert verdict.valid
    early = previous[(previous["command"] == "collect") & (previous["start"] < at(5))]
    assert set(early["image_id"]) <= set(made.schedule["image_id"].dropna())
    free = {"previous": previous, "rules": rules, "price": False, "options": EXACT}
    exact = make_plan(case.tables, case.spacecraft, **free)
    monkeypatch.setattr("services.planning.sequencing.sequence.LARGEST_CELLS", 0)
    found = make_plan(case.tables, case.spacecraft, **free)
    assert found.plan.objective <= exact.plan.bound + 1e-6
    assert exact.plan.objective <= found.plan.bound + 1e-6


def test_commands_of_the_previous_plan_count_for_the_day(monkeypatch: pytest.MonkeyPatch) -> None:
    """A recording and a downlink are frozen, two commands a day are allowed: the search adds no downlink."""
    from tests.services.planning.planning_cases import at

    case = small(5187791, satellites=2)
    previous = make_plan(case.tables, case.spacecraft).schedule
    rules = OperationRules(min_collect_s=4, max_commands_per_day=2, frozen_until=at(5))
    monkeypatch.setattr("services.planning.sequencing.sequence.LARGEST_CELLS", 0)
    made = make_plan(case.tables, case.spacecraft, previous=previous, rules=rules, price=False, options=EXACT)
    assert (made.schedule["start"] < at(5)).all()
    assert len(made.schedule) == 2
