"""Bad input over HTTP: a problem document that names field, value and cure; never a traceback, nothing left behind."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from fastapi.testclient import TestClient

from services.planning.processes import PROCESSES
from shared.contracts import tables
from shared.contracts.schema import write_table
from shared.process.app import create_app
from shared.settings import ServiceSettings
from tests.services.planning.planning_cases import START, Case, at, random_case
from tests.services.planning.test_planning_process import stage

CASE = replace(random_case(11, 2, 10, tight=False), eclipses=[])
Files = Callable[[Path, dict[str, Any]], dict[str, Any]]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TestClient, Path]]:
    root = tmp_path_factory.mktemp("http")
    app = create_app("planning", "Planning", PROCESSES, settings=ServiceSettings(artifact_root=str(root)))
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client, root


def spacecraft(change: dict[str, Any]) -> Files:
    def edit(root: Path, body: dict[str, Any]) -> dict[str, Any]:
        path = root / body["spacecraft"]["href"]
        path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
        return body

    return edit


def body(change: dict[str, Any]) -> Files:
    return lambda root, given: {**given, **change}


def table(name: str, edit: Callable[[pd.DataFrame], pd.DataFrame]) -> Files:
    """The table written as it is, past its contract: what a careless client would send."""

    def write(root: Path, given: dict[str, Any]) -> dict[str, Any]:
        path = root / given[name]["href"]
        edit(pd.read_parquet(path)).to_parquet(path)
        return given

    return write


def case(changed: Case) -> Files:
    def write(root: Path, given: dict[str, Any]) -> dict[str, Any]:
        for name, frame in changed.tables.items():
            write_table(root / given[name]["href"], frame, tables.ALL[name.upper()])
        return given

    return write


CHANGE = {"target_id": 0, "who": "duty officer", "why": "test", "when": START.isoformat()}
BAD: dict[str, tuple[Files, str]] = {
    "overlapping contacts": (
        case(replace(CASE, contacts=[("CYGFM01", "hawaii", 1, 6), ("CYGFM01", "hawaii", 5, 9)])), "contacts.start"),
    "contact backwards": (case(replace(CASE, contacts=[("CYGFM01", "hawaii", 6, 5)])), "contacts.end"),
    "unknown target": (case(replace(CASE, images=[(0, "CYGFM01", 1.0, [77])])), "opportunities.target_id"),
    "negative reward": (table("targets", lambda f: f.assign(priority=-1.0)), "priority"),
    "missing column": (table("contacts", lambda f: f.drop(columns="end")), "end"),
    "eclipse backwards": (case(replace(CASE, eclipses=[("CYGFM01", 5.0, 4.0)])), "eclipses.end"),
    "battery below floor": (spacecraft({"battery_initial_wh": 1.0}), "spacecraft"),
    "one battery below floor": (
        spacecraft({"satellites": {"CYGFM01": {"battery_initial_wh": 1.0}}}), "spacecraft.battery_initial_wh"),
    "empty horizon": (spacecraft({"horizon_s": 0}), "spacecraft.horizon_s"),
    "endless horizon": (spacecraft({"horizon_s": 10**9}), "spacecraft.horizon_s"),
    "window backwards": (
        spacecraft({"satellites": {"CYGFM01": {"unavailable": [
            {"start": at(5).isoformat(), "end": at(4).isoformat()}]}}}), "spacecraft.satellites.CYGFM01.unavailable.0"),
    "negative slew": (spacecraft({"slew": {"a": {"b": -1}}}), "spacecraft.slew.a.b"),
    "not JSON": (lambda root, b: (root / b["spacecraft"]["href"]).write_text("{") and b, "spacecraft.json"),
    "unknown option": (body({"min_colect_s": 3}), "min_colect_s"),
    "negative recording": (body({"min_collect_s": 0}), "min_collect_s"),
    "share above one": (body({"nominal_share": 1.5}), "nominal_share"),
    "outage of nothing": (body({"outages": [{"start": at(0).isoformat()}]}), "outages"),
    "outage backwards": (
        body({"outages": [{"station": "hawaii", "start": at(3).isoformat(), "end": at(1).isoformat()}]}), "outages"),
    "anonymous change": (body({"target_changes": [{**CHANGE, "action": "pin", "who": ""}]}), "target_changes"),
    "reweight to nothing": (body({"target_changes": [{**CHANGE, "action": "reweight"}]}), "target_changes"),
    "change of nobody": (
        body({"target_changes": [{**CHANGE, "action": "pin", "target_id": 999}]}), "target_changes[0].target_id"),
    "missing file": (body({"targets": {"href": "in/none.parquet"}}), ""),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_answered_with_a_problem_document(service: tuple[TestClient, Path], name: str) -> None:
    client, root = service
    edit, field = BAD[name]
    folder = root / name.replace(" ", "-")
    inputs = stage(folder, CASE)
    for reference in inputs.values():
        reference["href"] = f"{folder.name}/{reference['href']}"
    inputs = edit(root, inputs)
    answer = client.post("/processes/plan-observations/execution", json={"inputs": {**inputs, "case": folder.name}})
    assert 400 <= answer.status_code < 500, answer.text
    assert answer.headers["content-type"].startswith("application/problem+json")
    assert field in answer.text and "Traceback" not in answer.text
    assert not list((root / folder.name).rglob("schedule.parquet"))


def test_good_input_is_planned_and_checked_over_http(service: tuple[TestClient, Path]) -> None:
    client, root = service
    inputs = {name: {"href": f"good/{ref['href']}"} for name, ref in stage(root / "good", CASE).items()}
    options = {"min_collect_s": 2, "mode_switch_s": 1}
    planned = client.post("/processes/plan-observations/execution", json={"inputs": {**inputs, **options}}).json()
    assert planned["gap"] <= 0.005 and len(planned["commands"]) == 2
    schedule = {"schedule": planned["schedule"]}
    checked = client.post("/processes/check-plan/execution", json={"inputs": {**inputs, **options, **schedule}}).json()
    assert checked["valid"] is True
    strict = {**options, "min_collect_s": 13}
    refused = client.post("/processes/check-plan/execution", json={"inputs": {**inputs, **strict, **schedule}}).json()
    assert refused["valid"] is False and refused["violations"][0].startswith("min-collect: CYGFM0")
