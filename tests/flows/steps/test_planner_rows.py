"""Planner rows: ours stand under the published ones, and say no more than the planner's report."""

from __future__ import annotations

import re
from typing import Any

from flows.cases.paper_days.published_rows import LA, rows_of
from flows.desk.standing import CYCLE
from flows.display import planner_table
from flows.published_day import ROWS, TESTS, _timed
from flows.steps.planner_rows import COLUMNS, own_row, published_row


def report(prefire: int) -> dict[str, Any]:
    active = {"planned": 9, "available": 10, "reward_available": 40.0, "reward_planned": 36.0}
    other = {"planned": prefire, "available": prefire, "reward_available": 5.0 * prefire, "reward_planned": 5.0}
    return {
        "gap": 0.0123456789,
        "reward": 36.0 + other["reward_planned"],
        "targets": {"active": active, "prefire": other},
    }


def test_a_published_row_keeps_every_figure() -> None:
    told = rows_of(LA)[0]
    row = published_row(told)
    assert set(row) == set(COLUMNS) and row["whose"] == "paper"
    assert {name: row[name] for name in told if name != "kind"} == {name: told[name] for name in told if name != "kind"}
    assert row["reward_share"] == 0.9927  # 99.3 % in the paper


def test_our_row_is_the_report_and_active_only_has_no_prefire_counts() -> None:
    row = own_row("LA", report(2))
    assert (row["gap"], row["active_planned"], row["active_available"]) == (0.012346, 9, 10)
    assert row["reward_share"] == round(41 / 50, 4) and row["prefire_planned"] == 2
    assert own_row("LA", report(0))["prefire_available"] is None
    assert row["solve_time"] == ""  # no clock in a product


def test_the_seconds_of_a_run_stand_at_our_rows_only() -> None:
    rows = [row for told in rows_of(LA) for row in (published_row(told), own_row(told["test"], report(2)))]
    timed = _timed(rows, [50.0, 20.0, 0.4])
    assert [row["solve_time"] for row in timed] == ["3 h", "50.0 s", "41 min", "20.0 s", "0.01 s", "0.4 s"]
    assert len(TESTS) == len(rows_of(LA)) and planner_table(timed).row_count == 6


def test_the_plans_behind_the_rows_are_no_plans_of_the_cycle() -> None:
    """The desk takes the newest plan of a cycle for the one on board: these lie beside it."""
    assert not re.fullmatch(CYCLE, ROWS)
