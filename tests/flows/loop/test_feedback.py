"""Each feedback matters: take it away, and the second cycle's targets or plan are others."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import pytest

from flows.comparison import compare_schedules, compare_targets, read_reference
from flows.desk.approval import NobodyDecides
from flows.loop import taken
from flows.loop_types import FEEDBACKS, Handover
from flows.stages import decide, plan, prioritise
from shared.contracts import tables

if TYPE_CHECKING:
    from conftest import TinyLoop

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]


@pytest.mark.parametrize("name", sorted(FEEDBACKS))
def test_without_it_the_second_cycle_is_another(tiny: TinyLoop, name: str) -> None:
    first, second = tiny.cycles
    feedback = frozenset(FEEDBACKS) - {name}
    runner = tiny.runner(f"without-{name}")
    given = taken(first.handover, feedback)
    steps = prioritise(runner, tiny.inputs, second.cutoff, given, feedback, tiny.profile.settings)
    steps |= decide(runner, NobodyDecides(), second.label, steps)
    steps |= plan(runner, tiny.inputs, second.cutoff, given, steps, tiny.profile.settings, NobodyDecides())
    pairs = [
        [read_reference(s[step][table], schema) for s in (second.steps, steps)]
        for step, table, schema in (
            ("build-targets", "targets", tables.TARGETS),
            ("plan-observations", "schedule", tables.SCHEDULE),
        )
    ]
    targets = compare_targets(*pairs[0])
    images = compare_schedules(*pairs[1])
    plan_differs = images["images_only_with"] + images["images_only_without"] > 0 or not pairs[1][0].equals(pairs[1][1])
    assert any(targets.values()) or plan_differs, f"{name}: {targets} {images}"


def test_with_all_feedback_the_second_cycle_is_answered_from_the_store(tiny: TinyLoop) -> None:
    """The control of the test above: nothing taken away, nothing changes, down to the hash."""
    first, second = tiny.cycles
    feedback = frozenset(FEEDBACKS)
    runner = tiny.runner(second.label)
    given = taken(first.handover, feedback)
    steps = prioritise(runner, tiny.inputs, second.cutoff, given, feedback, tiny.profile.settings)
    assert steps["build-targets"] == second.steps["build-targets"]


def test_a_handover_carries_products_not_intentions() -> None:
    kept = {field.name for field in dataclasses.fields(Handover)}
    assert "as_run" in kept
    assert not kept & {"targets", "opportunities"}
