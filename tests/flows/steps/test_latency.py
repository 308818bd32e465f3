"""The latency budget held against times that can be counted by hand, and the log of computing times."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import pandas as pd
import pytest

from flows.steps.latency import latency_budget
from flows.timings import note_seconds, step_seconds

DAY = pd.Timestamp("2025-09-01T12:00:00Z")


def at(hour: float) -> pd.Timestamp:
    return DAY + pd.Timedelta(hours=hour)


def observations(*rows: tuple[float, float, float]) -> pd.DataFrame:
    frame = pd.DataFrame([[at(hour) for hour in row] for row in rows], columns=["observed", "downlinked", "ready"])
    return frame.astype("datetime64[ms, UTC]")


def contacts(*rows: tuple[str, float]) -> pd.DataFrame:
    return pd.DataFrame([{"satellite": name, "start": at(hour), "end": at(hour + 0.1)} for name, hour in rows])


def test_each_step_is_what_a_clock_says() -> None:
    seen = {"raw-if": observations((1, 3, 3), (20, 23, 23), (-8, 1, 1)), "nominal": observations((0, 2, 4))}
    passes = contacts(("A", 10), ("A", 24.5), ("A", 26), ("B", 29), ("C", 5))
    told = latency_budget(seen, passes, "ABCD", at(24), timedelta(hours=1))
    raw_if, nominal = told["modes"]["raw-if"], told["modes"]["nominal"]
    assert raw_if["observed_to_downlinked_h"] == {"median": 3.0, "p95": 8.4, "longest": 9.0}
    assert raw_if["observed_to_product_h"]["longest"] == 32.0 and raw_if["share_within_30_h"] == 0.6667
    assert raw_if["level1_to_product_h"]["median"] == 21.0
    assert {name: nominal[name]["median"] for name in nominal if name.endswith("_h") and "share" not in name} == {
        "observed_to_downlinked_h": 2.0,
        "downlinked_to_level1_h": 2.0,
        "level1_to_product_h": 20.0,
        "observed_to_product_h": 24.0,
        "observed_to_next_plan_h": 24.0 + 1.0 + 2.5,  # A is reached 1 h after the release, B 4 h
    }
    assert nominal["observed_to_next_plan_h"]["longest"] == 24.0 + 1.0 + 4.0
    # Six pairs of three images (32, 23 and 4 h before the products) and two satellites (2 and 5 h after them).
    assert raw_if["observed_to_next_plan_h"] == {"median": 26.5, "p95": 36.25, "longest": 37.0}
    assert told["next_plan"]["to_uplink_h"] == {"median": 2.5, "p95": 3.85, "longest": 4.0}
    assert told["satellites_not_reached"] == 2  # C has no contact after the release, D none at all


@pytest.mark.parametrize("dtype", ["datetime64[ms, UTC]", "datetime64[ns]", "object"])
def test_a_cycle_that_brought_nothing_down_has_no_hours(dtype: str) -> None:
    nothing = observations().assign(downlinked=pd.Series([], dtype=dtype), ready=pd.Series([], dtype=dtype))
    told = latency_budget({"raw-if": nothing}, contacts(("A", 1)), ["A"], at(24), timedelta(hours=1))
    raw_if = told["modes"]["raw-if"]
    assert raw_if["observed_to_next_plan_h"] == {"median": None, "p95": None, "longest": None}
    assert (raw_if["observations"], raw_if["share_within_30_h"]) == (0, None)
    assert raw_if["observed_to_product_h"] == {"median": None, "p95": None, "longest": None}


@pytest.mark.parametrize("unfinished", ["", '{"cycle": "c1", "pro', "null\n"])
def test_a_step_took_as_long_as_when_it_was_made(tmp_path: Path, unfinished: str) -> None:
    note_seconds(tmp_path, "case", "c1", "simulate-observations", "case/c1/simulate-observations/a", 4.0)
    note_seconds(tmp_path, "case", "c1", "simulate-observations", "case/c1/simulate-observations/b", 2.0)
    note_seconds(tmp_path, "case", "c1", "simulate-observations", "case/c1/simulate-observations/a", 0.1)
    with (tmp_path / ".timings" / "case.jsonl").open("a") as stream:
        stream.write(unfinished)
    assert step_seconds(tmp_path, "case") == {"c1": {"simulate-observations": 6.0}}
    assert step_seconds(tmp_path, "other") == {}
