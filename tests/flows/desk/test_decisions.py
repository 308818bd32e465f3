"""What people decided: kept whole, in force from a cycle on, the latest word about a target or a plan."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from flows.desk.approval import AwaitingApproval, PeopleDecide
from flows.desk.decisions import Decision, DecisionLog, added_id, additions, keep, target_changes, verdict_on
from flows.steps.decided import Addition, added_rows
from shared.contracts import tables
from shared.errors import DomainError

FIRST, SECOND, THIRD = "20250901T1200Z", "20250902T1200Z", "20250903T1200Z"
PLAN = {"sha256": 64 * "a"}
RELEASE = datetime(2025, 9, 1, 13, tzinfo=UTC)
_begin = datetime(2025, 9, 1, tzinfo=UTC)


def said(minute: int, action: str, cycle: str = FIRST, **more: Any) -> Decision:
    at = _begin + timedelta(minutes=minute)
    return Decision(at=at, who="ann", why="because", action=action, cycle=cycle, **more)


def test_a_log_keeps_what_was_decided_in_order(tmp_path: Path) -> None:
    log = DecisionLog(tmp_path, "case")
    later, earlier = said(5, "pin", target_id=7), said(1, "exclude", target_id=8)
    for decision in (later, earlier):
        log.append(decision)
    assert DecisionLog(tmp_path, "case").all() == [earlier, later]
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_damaged_decision_is_named(tmp_path: Path) -> None:
    log = DecisionLog(tmp_path, "case")
    log.append(said(1, "pin", target_id=7))
    (path,) = tmp_path.rglob("*.json")
    path.write_text("{")
    with pytest.raises(DomainError, match=path.name):
        log.all()


@pytest.mark.parametrize("case", ["../other", "", ".hidden", "a/b"])
def test_a_log_stays_in_its_folder(tmp_path: Path, case: str) -> None:
    with pytest.raises(DomainError, match="name of a case"):
        DecisionLog(tmp_path, case)


@pytest.mark.parametrize(
    ("action", "missing"),
    [
        ("approve", "schedule_sha256"),
        ("pin", "target_id"),
        ("release", "target_id"),
        ("add", "kind"),
        ("reweight", "target_id"),
    ],
)
def test_half_a_decision_is_none(action: str, missing: str) -> None:
    with pytest.raises(ValidationError, match=f"to {action} needs '{missing}'"):
        said(1, action)


def test_a_decision_needs_somebody_and_a_reason() -> None:
    for wrong in ({"who": ""}, {"why": ""}, {"cycle": "tomorrow"}, {"priority": float("inf")}, {"priority": -1.0}):
        values = {"who": "a", "why": "b", "action": "pin", "cycle": FIRST, "target_id": 1} | wrong
        with pytest.raises(ValidationError):
            Decision(**values)


def test_the_latest_word_about_a_target_counts() -> None:
    story = [
        said(1, "pin", target_id=1),
        said(2, "reweight", target_id=1, priority=0.5),
        said(3, "exclude", target_id=2),
        said(4, "pin", target_id=2),
        said(5, "reweight", target_id=3, priority=0.2),
        said(6, "exclude", target_id=3),
        said(7, "pin", target_id=4),
        said(8, "release", target_id=4),
        said(9, "reweight", target_id=1, priority=0.7),
    ]
    found = [(c["target_id"], c["action"], c.get("priority")) for c in target_changes(story, FIRST)]
    assert found == [(1, "pin", None), (1, "reweight", 0.7), (2, "pin", None), (3, "exclude", None)]
    assert {(c["who"], c["why"]) for c in target_changes(story, FIRST)} == {("ann", "because")}


def test_a_decision_holds_from_its_cycle_to_its_last() -> None:
    story = [said(1, "pin", SECOND, target_id=1), said(2, "exclude", FIRST, until=SECOND, target_id=2)]
    held = {cycle: [c["target_id"] for c in target_changes(story, cycle)] for cycle in (FIRST, SECOND, THIRD)}
    assert held == {FIRST: [2], SECOND: [1, 2], THIRD: [1]}


def test_added_ids_fit_the_contract_and_keep_their_id() -> None:
    place = {"kind": "active", "priority": 0.8, "longitude_deg": -110.5, "latitude_deg": 34.25}
    story = [said(1, "add", **place), said(2, "add", **{**place, "priority": 0.9})]
    rows = added_rows([Addition(**item) for item in additions(story, FIRST)])
    checked = tables.TARGETS.check(rows)
    assert len(checked) == 1 and checked["priority"].iloc[0] == 0.9, "one place, the latest word"
    assert checked["source"].iloc[0] == "added by ann: because"
    same, other = (Addition(**place, source="x"), Addition(**{**place, "latitude_deg": 34.26}, source="x"))
    assert added_id(same) == checked["target_id"].iloc[0] != added_id(other)
    assert 0 < added_id(same) < 2**53


@pytest.mark.parametrize("action", ["exclude", "release"])
def test_an_added_id_is_taken_back_by_its_id(action: str) -> None:
    place = {"kind": "active", "priority": 0.8, "longitude_deg": -110.5, "latitude_deg": 34.25}
    first, other = said(1, "add", **place), said(2, "add", **{**place, "latitude_deg": 34.3})
    gone = said(3, action, SECOND, target_id=added_id(first))
    assert [item["latitude_deg"] for item in additions([first, other, gone], SECOND)] == [34.3]
    assert len(additions([first, other, gone], FIRST)) == 2, "the cycle before had it"
    assert len(additions([first, other, gone, said(4, "add", SECOND, **place)], SECOND)) == 2, "added again"


def test_a_reward_off_the_scale_is_not_kept(tmp_path: Path) -> None:
    place = {"kind": "prefire", "priority": 0.95, "longitude_deg": -110.5, "latitude_deg": 34.25}
    with pytest.raises(DomainError, match="no such reward") as caught:
        keep(tmp_path, "case", who="ann", why="x", action="add", cycle=FIRST, **place)
    assert (caught.value.field, caught.value.accepted) == ("priority", "0 to 0.9")
    assert not DecisionLog(tmp_path, "case").all(), "kept, it would end every later cycle"


@pytest.mark.parametrize(("kind", "priority"), [("active", 0.05), ("active", 1.5), ("prefire", 0.95)])
def test_an_added_reward_keeps_to_the_scale(kind: Any, priority: float) -> None:
    with pytest.raises(DomainError, match="no reward of its scale"):
        added_rows([Addition(kind=kind, priority=priority, longitude_deg=0, latitude_deg=0, source="x")])


def test_a_plan_is_a_draft_until_it_is_approved(tmp_path: Path) -> None:
    desk = PeopleDecide.of_case(tmp_path, "case", automatic=False)
    with pytest.raises(AwaitingApproval, match="awaits approval"):
        desk.approval(FIRST, PLAN, RELEASE)
    desk.log.append(said(1, "approve", schedule_sha256=64 * "b"))
    with pytest.raises(AwaitingApproval):
        desk.approval(FIRST, PLAN, RELEASE)  # that was another plan
    desk.log.append(said(2, "approve", schedule_sha256=PLAN["sha256"]))
    assert desk.approval(FIRST, PLAN, RELEASE) == {"approved_by": "ann", "approved_at": "2025-09-01T00:02:00+00:00"}
    desk.log.append(said(3, "reject", schedule_sha256=PLAN["sha256"]))
    with pytest.raises(AwaitingApproval, match=r"rejected by ann \(because\)"):
        desk.approval(FIRST, PLAN, RELEASE)
    assert verdict_on(desk.log.all(), PLAN["sha256"]).action == "reject"


def test_a_setting_approves_what_nobody_rejected(tmp_path: Path) -> None:
    desk = PeopleDecide.of_case(tmp_path, "case", automatic=True)
    assert desk.approval(FIRST, PLAN, RELEASE) == {"approved_by": "setting", "approved_at": RELEASE.isoformat()}
    desk.log.append(said(1, "reject", schedule_sha256=PLAN["sha256"]))
    with pytest.raises(AwaitingApproval, match="rejected"):
        desk.approval(FIRST, PLAN, RELEASE)
