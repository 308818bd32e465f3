"""Cases of the paper's size: the proven bound of the data notes, all active targets, and a thinned case in seconds."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from services.planning.operations import make_plan
from services.planning.planner import Options
from services.planning.spacecraft_limits import read_spacecraft
from shared.contracts import tables
from shared.contracts.schema import read_table


def load(folder: Path, craft: str = "spacecraft.json") -> tuple[dict[str, pd.DataFrame], dict[str, object]]:
    names = ("opportunities", "targets", "contacts", "eclipses")
    return (
        {name: read_table(folder / f"{name}.parquet", tables.ALL[name.upper()]) for name in names},
        json.loads((folder / craft).read_text()),
    )


def thin(frames: dict[str, pd.DataFrame], every: int) -> dict[str, pd.DataFrame]:
    """All active targets and every so many pre-fire ones."""
    targets = frames["targets"]
    kept = targets[(targets["kind"] == "active") | (targets["target_id"] % every == 0)]
    seen = frames["opportunities"]
    return {**frames, "targets": kept, "opportunities": seen[seen["target_id"].isin(kept["target_id"])]}


@pytest.mark.parametrize("craft", ["spacecraft.json", "spacecraft_tight.json"])
def test_a_thinned_case_is_planned_to_its_gap(real_data: Path, craft: str) -> None:
    frames, document = load(real_data / "planning/table1-tx", craft)
    small = read_spacecraft({**document, "storage_images": 20})  # so that storage binds in the thinned case too
    made = make_plan(thin(frames, 20), small, options=Options(mip_gap=0.001))
    assert made.plan.gap <= 0.001 and not made.plan.time_limited
    active = made.report["targets"]["active"]
    assert active["planned"] == active["available"] == 359
    assert made.report["targets"]["prefire"]["planned"] < made.report["targets"]["prefire"]["available"]
    assert made.report["greedy_baseline"]["objective"] < made.plan.objective
    assert made.report["latency"]["max_h"] < 24


def test_active_targets_alone_are_optimal(real_data: Path) -> None:
    frames, document = load(real_data / "planning/table1-la")
    made = make_plan(thin(frames, 10**9), read_spacecraft(document), options=Options(mip_gap=1e-6))
    assert made.plan.gap < 1e-6
    assert made.report["targets"]["active"]["planned"] == made.report["targets"]["active"]["available"] == 138


def test_the_first_second_already_has_a_plan_and_a_bound(real_data: Path) -> None:
    frames, document = load(real_data / "planning/table1-tx")
    made = make_plan(frames, read_spacecraft(document), options=Options(time_limit_s=0.2))
    assert made.plan.time_limited
    everything = sum(kind["reward_available"] for kind in made.report["targets"].values())
    assert made.plan.objective > made.report["greedy_baseline"]["objective"]
    assert made.plan.bound < 0.99 * everything
    assert made.report["targets"]["active"]["planned"] == 359
