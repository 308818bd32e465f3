"""Which cycles are due at a moment, and which of them are gone through."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.serving.due import cycles_begun, cycles_to_run, hour_of

FIRST = datetime(2025, 9, 1, 12, tzinfo=UTC)


@pytest.mark.parametrize(
    ("after_h", "cycle_hours", "begun"),
    [
        (-0.01, 24, 0),
        (0, 24, 1),
        (23.99, 24, 1),
        (24, 24, 2),
        (24 * 9 + 1, 24, 10),
        (5.9, 6, 1),
        (6, 6, 2),
        (30, 12, 3),
    ],
)
def test_a_cycle_begins_with_its_cut_off(after_h: float, cycle_hours: int, begun: int) -> None:
    assert cycles_begun(FIRST, cycle_hours, FIRST + timedelta(hours=after_h)) == begun


def test_missed_cycles_are_caught_up_or_left_out() -> None:
    assert cycles_to_run(5, {1, 2}, "catch-up") == [1, 2, 3, 4, 5]
    assert cycles_to_run(5, {1, 2}, "skip") == [1, 2, 5]
    assert cycles_to_run(0, set(), "skip") == []


@given(begun=st.integers(0, 40), planned=st.sets(st.integers(1, 40)), missed=st.sampled_from(["catch-up", "skip"]))
def test_what_is_run_is_in_order_and_ends_with_the_current_cycle(begun: int, planned: set[int], missed: str) -> None:
    numbers = cycles_to_run(begun, planned, missed)  # type: ignore[arg-type]
    assert numbers == sorted(set(numbers)) and numbers[-1:] == ([begun] if begun else [])
    assert planned & set(range(1, begun + 1)) <= set(numbers)


def test_an_hour_begins_at_its_full_hour() -> None:
    assert hour_of(datetime(2025, 9, 1, 12, 59, 59, 9, tzinfo=UTC)) == datetime(2025, 9, 1, 12, tzinfo=UTC)
