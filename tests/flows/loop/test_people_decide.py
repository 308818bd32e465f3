"""People decide, through the real services: a draft waits, an approval lets it go, an excluded target is in no plan."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import pytest

from flows.comparison import local_file
from flows.desk.approval import AwaitingApproval, CycleUnderWay, PeopleDecide
from flows.desk.decisions import keep
from flows.desk.standing import plan_standings
from flows.loop import run_cycle, taken
from flows.loop_types import FEEDBACKS
from flows.stages import decide, plan
from flows.steps.decided import Addition, added_id

if TYPE_CHECKING:
    from conftest import TinyLoop

ALL = frozenset(FEEDBACKS)

pytestmark = [pytest.mark.xdist_group("loop"), pytest.mark.loop]


@pytest.fixture
def desk(tiny: TinyLoop) -> PeopleDecide:
    return PeopleDecide.of_case(tiny.root, tiny.case.name, automatic=False)


def again(tiny: TinyLoop, desk: PeopleDecide, **more: object) -> object:
    """The second cycle run once more: whatever is unchanged is answered from the store."""
    first, second = tiny.cycles
    settings = tiny.profile.settings
    given = (tiny.runner(second.label), tiny.inputs, second.cutoff, first.handover, ALL, settings, desk)
    return run_cycle(*given, **more)


def test_a_draft_waits_and_an_approval_lets_it_go(tiny: TinyLoop, desk: PeopleDecide) -> None:
    second = tiny.cycles[1]
    with pytest.raises(AwaitingApproval, match=second.label) as waiting:
        again(tiny, desk)
    digest = waiting.value.schedule["sha256"]
    assert digest == second.steps["plan-observations"]["schedule"]["sha256"]
    approved = {"action": "approve", "who": "ann", "why": "checked", "cycle": second.label}
    keep(tiny.root, tiny.case.name, schedule_sha256=digest, **approved)
    finished = again(tiny, desk)
    assert finished.steps["execute"] == second.steps["execute"], "who approved it changes nothing of what it brings"
    standing = plan_standings(tiny.root, tiny.case.name, desk.log.all())[-1]
    assert (standing.cycle, standing.history[1][:2]) == (second.label, ("approved", "ann"))
    assert standing.state == "downlinked"


def test_a_cycle_that_is_not_over_ends_at_its_uplink(tiny: TinyLoop) -> None:
    second = tiny.cycles[1]
    setting = PeopleDecide.of_case(tiny.root, tiny.case.name, automatic=True)
    with pytest.raises(CycleUnderWay, match=second.label):
        again(tiny, setting, now=second.end - timedelta(seconds=1))
    assert again(tiny, setting, now=second.end).steps["execute"] == second.steps["execute"]


def test_what_people_decided_about_targets_is_in_the_plan(tiny: TinyLoop, desk: PeopleDecide, tmp_path: Path) -> None:
    first, second = tiny.cycles
    outcomes = outcomes_of(second.steps["plan-observations"])
    unwanted = int(outcomes.index[outcomes["observed"] & (outcomes["kind"] == "prefire")][0])
    own = PeopleDecide.of_case(tmp_path, tiny.case.name, automatic=True)
    common = {"who": "ann", "why": "because", "cycle": second.label}
    keep(tmp_path, tiny.case.name, action="exclude", target_id=unwanted, **common)
    keep(tmp_path, tiny.case.name, action="exclude", target_id=42, **common)  # no such target any more
    west, south, east, north = tiny.inputs.region
    place = {"longitude_deg": (west + east) / 2, "latitude_deg": (south + north) / 2}
    keep(tmp_path, tiny.case.name, action="add", kind="prefire", priority=0.9, **place, **common)

    runner, settings = tiny.runner("decided"), tiny.profile.settings
    steps = dict(second.steps) | decide(runner, own, second.label, second.steps)
    decided = steps["apply-decisions"]
    assert (decided["added"], [c["target_id"] for c in decided["without_target"]]) == (1, [42])
    made = plan(runner, tiny.inputs, second.cutoff, taken(first.handover, ALL), steps, settings, own)
    planned = outcomes_of(made["plan-observations"])
    assert made["check-plan"]["valid"]
    assert unwanted not in planned.index[planned["observed"]]
    added = added_id(Addition(kind="prefire", priority=0.9, source="", **place))
    assert added in planned.index, "the target added by hand has its line"


def outcomes_of(planned: object) -> pd.DataFrame:
    folder = local_file(planned["schedule"]).parent
    return pd.read_parquet(folder / "target_outcomes.parquet").set_index("target_id")
