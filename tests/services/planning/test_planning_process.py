"""Both processes as steps: artifacts keep their contracts, the same bytes twice, check-plan agrees and disagrees."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from services.planning.processes import PROCESSES
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from shared.errors import DomainError
from shared.process.execution import resolve_step, run_step, validate_inputs
from tests.services.planning.planning_cases import Case, random_case

CASE = random_case(11, 3, 24, tight=False)


def stage(root: Path, case: Case) -> dict[str, Any]:
    (root / "in").mkdir(parents=True, exist_ok=True)
    for name, frame in case.tables.items():
        write_table(root / f"in/{name}.parquet", frame, tables.ALL[name.upper()])
    (root / "in/spacecraft.json").write_text(case.spacecraft.model_dump_json())
    return {name: {"href": f"in/{name}.parquet"} for name in case.tables} | {
        "spacecraft": {"href": "in/spacecraft.json"}
    }


def run(root: Path, which: int, inputs: dict[str, Any]) -> dict[str, Any]:
    store = ArtifactStore(Roots(str(root)))
    seen: list[float] = []
    step = resolve_step(PROCESSES[which], validate_inputs(PROCESSES[which], inputs), store, "test")
    outputs = run_step(step, store, "test", "job", lambda percent, _: seen.append(percent))
    assert seen == sorted(seen)
    return outputs


def local(outputs: dict[str, Any], name: str) -> Path:
    return Path(outputs[name]["href"].removeprefix("file://"))


def test_plan_then_check(tmp_path: Path) -> None:
    inputs = stage(tmp_path, CASE)
    planned = run(tmp_path, 0, inputs)
    schedule = read_table(local(planned, "schedule"), tables.SCHEDULE)
    assert set(schedule["command"]) == {"collect", "downlink"}
    report = json.loads(local(planned, "report").read_text())
    assert report["objective"] == pytest.approx(planned["objective"])
    assert planned["gap"] == pytest.approx((planned["bound"] - planned["objective"]) / planned["bound"], abs=1e-12)
    features = json.loads(local(planned, "footprints").read_text())["features"]
    assert len(features) == planned["targets_planned"] > 0
    assert local(planned, "gantt").read_bytes().startswith(b"\x89PNG")
    checked = run(tmp_path, 1, {**inputs, "schedule": planned["schedule"]})
    assert checked["valid"] and checked["violations"] == []
    late = schedule.assign(end=schedule["end"].where(schedule["command"] == "collect", schedule["end"].max()))
    write_table(tmp_path / "in/late.parquet", late, tables.SCHEDULE)
    refused = run(tmp_path, 1, {**inputs, "schedule": {"href": "in/late.parquet"}})
    assert not refused["valid"] and "CYGFM0" in refused["violations"][0]


def test_same_inputs_same_bytes(tmp_path: Path) -> None:
    first, second = (run(tmp_path / name, 0, stage(tmp_path / name, CASE)) for name in ("a", "b"))
    for name in ("schedule", "report", "gantt", "footprints"):
        assert local(first, name).read_bytes() == local(second, name).read_bytes(), name


def test_bad_input_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    inputs = stage(tmp_path, CASE)
    document = json.loads((tmp_path / "in/spacecraft.json").read_text())
    (tmp_path / "in/spacecraft.json").write_text(json.dumps({**document, "horizon_s": 0}))
    with pytest.raises(DomainError) as caught:
        run(tmp_path, 0, inputs)
    assert caught.value.field == "spacecraft.horizon_s"
    assert not list(tmp_path.rglob("schedule.parquet"))
