"""A finished loop met by faults: artifacts damaged behind its back, a clock that jumps; and its latency budget."""

from __future__ import annotations

import random
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from flows.commands.latency import latency_of
from flows.desk.approval import CycleUnderWay
from flows.loop import run_cycle
from flows.loop_types import FEEDBACKS, Handover, cycle_label
from flows.serving.due import cycles_begun
from shared.artifacts.manifest import MANIFEST

if TYPE_CHECKING:
    from conftest import TinyLoop

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]
ALL = frozenset(FEEDBACKS)
DAMAGED = ("build-targets/*/targets.parquet", "check-plan/*/*.json", "observed-places/*/observed.parquet")


def state(folder: Path) -> dict[Path, tuple[bytes, int]]:
    """Content and time of every file."""
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}


def test_damaged_artifacts_are_made_again_and_nothing_else(tiny: TinyLoop) -> None:
    cycle, before = tiny.cycles[1], tiny.cycles[0].handover
    folder = tiny.root / tiny.case.name / cycle.label
    whole, draw, damaged = state(folder), random.Random(7), []
    for pattern in DAMAGED:
        path = next(path for path in sorted(folder.glob(pattern)) if path.name != MANIFEST)
        content = bytearray(path.read_bytes())
        content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)  # one bit
        path.write_bytes(content)
        damaged.append(path)
    again = run_cycle(tiny.runner(cycle.label), tiny.inputs, cycle.cutoff, before, ALL, tiny.profile.settings)
    after = state(folder)
    assert {path: content for path, (content, _) in after.items()} == {path: c for path, (c, _) in whole.items()}
    made = {path.parent for path in after if after[path][1] != whole[path][1]}
    assert made == {path.parent for path in damaged}, "what was whole was left alone"
    assert again.handover == cycle.handover


def test_a_clock_that_jumps_undoes_nothing(tiny: TinyLoop) -> None:
    first, settings = tiny.cycles[0], tiny.profile.settings
    folder = tiny.root / tiny.case.name / first.label
    whole = state(folder)

    def turn(hours: float) -> None:
        now = first.cutoff + timedelta(hours=hours)
        begun = cycles_begun(tiny.case.first_cutoff, settings.cycle_hours, now)
        assert begun == (0 if hours < 0 else 1 + hours // 24)
        if begun == 0:
            return
        run = (tiny.runner(first.label), tiny.inputs, first.cutoff, Handover(), ALL, settings)
        if hours < 24:
            with pytest.raises(CycleUnderWay):
                run_cycle(*run, now=now)
        else:
            assert run_cycle(*run, now=now).handover == first.handover

    for hours in (12.0, 24 * 400.0, -24 * 400.0, 1.0, 30.0):  # on, a year ahead, a year back, and right again
        turn(hours)
        assert state(folder) == whole


def test_the_latency_budget_adds_up(tiny: TinyLoop) -> None:
    told = latency_of(tiny.root, "tiny")
    assert [report["cycle"] for report in told] == [cycle_label(cycle.cutoff) for cycle in tiny.cycles]
    for report, cycle in zip(told, tiny.cycles, strict=True):
        raw_if, nominal = report["modes"]["raw-if"], report["modes"]["nominal"]
        assert raw_if["observations"] == cycle.steps["execute"]["downlinked"]
        for mode in (raw_if, nominal):
            steps = ("observed_to_downlinked_h", "downlinked_to_level1_h", "level1_to_product_h")
            longest = sum(mode[step]["longest"] for step in steps)
            assert 0 < mode["observed_to_product_h"]["longest"] <= longest + 0.05
        assert nominal["downlinked_to_level1_h"]["median"] == tiny.profile.settings.level1_latency_h
        assert report["computing_s"]["products"] > 0 and report["computing_s"]["plan"] > 0
