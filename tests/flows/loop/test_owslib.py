"""A client that nobody here wrote: OWSLib lists, describes and executes a process of every service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from owslib.ogcapi.processes import Processes

if TYPE_CHECKING:
    from conftest import TinyLoop

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]


def requests_of(tiny: TinyLoop) -> dict[str, tuple[str, dict[str, Any]]]:
    """One request a service, with inputs from the finished first cycle."""
    steps = tiny.cycles[0].steps
    access, targets = steps["predict-access"], steps["build-targets"]["targets"]
    known = steps["assemble-inputs"]
    at, end = tiny.cycles[0].cutoff.isoformat(), tiny.cycles[0].end.isoformat()
    elements = {name: tiny.inputs.inputs[name] for name in ("receivers", "transmitters", "stations")}
    plan = {name: access[name] for name in ("opportunities", "contacts", "eclipses")}
    plan |= {"targets": targets, "spacecraft": steps["set-horizon"]["spacecraft"]}
    return {
        "access": ("predict-access", {**elements, "targets": targets, "start": at, "duration_s": 600}),
        "prioritization": ("forecast-fuel-moisture", {"weather": known["weather"], "time": at}),
        "planning": ("check-plan", {**plan, "schedule": steps["plan-observations"]["schedule"]}),
        "retrieval": (
            "retrieve-soil-moisture",
            {"observations": [steps["simulate-nominal"]["nominal"]], "reference": tiny.inputs.reference},
        ),
        "arrival": (
            "infer-fire-arrival",
            {
                "detections": known["detections"],
                "incidents": known["incidents"],
                "start": "2025-08-29T00:00:00Z",
                "end": end,
                "method": "nearest-detection",
            },
        ),
    }


@pytest.mark.parametrize("service", ["access", "prioritization", "planning", "retrieval", "arrival"])
def test_owslib_lists_describes_and_executes(tiny: TinyLoop, service: str) -> None:
    process, inputs = requests_of(tiny)[service]
    client = Processes(tiny.urls[service])
    assert process in [entry["id"] for entry in client.processes()]
    described = client.process(process)
    assert set(inputs) <= set(described["inputs"])
    outputs = client.execute(process, {**inputs, "case": "owslib"})
    assert set(outputs) <= set(described["outputs"])
    assert any(isinstance(value, dict) and value["href"].startswith("file://") for value in outputs.values())


@pytest.mark.parametrize("service", ["access", "prioritization", "planning", "retrieval", "arrival"])
def test_bad_input_is_a_named_problem_and_leaves_nothing(tiny: TinyLoop, service: str) -> None:
    import httpx

    process, inputs = requests_of(tiny)[service]
    name = next(key for key, value in inputs.items() if isinstance(value, dict | list))
    broken = {"href": "file:///etc/passwd"}
    before = sorted(tiny.root.rglob("*.parquet"))
    for value, word in ((broken, "/etc/passwd"), ({"href": "nowhere.parquet"}, "nowhere.parquet")):
        sent = {**inputs, name: [value] if isinstance(inputs[name], list) else value}
        answer = httpx.post(f"{tiny.urls[service]}/processes/{process}/execution", json={"inputs": sent}, timeout=60)
        assert answer.status_code == 422
        assert answer.headers["content-type"] == "application/problem+json"
        assert word in answer.json()["detail"]
    assert sorted(tiny.root.rglob("*.parquet")) == before
