"""The alert rules speak of metrics and processes that exist, and each says what it means for the people it wakes."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from flows.services import SERVICES
from shared.process.metrics import ServiceMetrics

FILE = Path(__file__).resolve().parents[3] / "flows" / "serving" / "alerts.yml"
RULES: list[dict[str, Any]] = yaml.safe_load(FILE.read_text())["groups"][0]["rules"]


def offered() -> set[str]:
    """The metrics of a service that has done one job."""
    metrics = ServiceMetrics("planning")
    with metrics.timing("plan-observations"):
        pass
    metrics.count("plan-observations", "successful")
    metrics.watch_queue(lambda: 0)
    facts = {"bytes": 1, "oldest_input": "2025-09-01T12:00:00Z", "simulated_share": 0.0}
    metrics.describe("plan-observations", {"gap": 0.01, "schedule": {}, "time_limited": False}, facts)
    return set(re.findall(r"^(smokeglint_\w+)", metrics.page().decode(), re.MULTILINE))


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])
def test_a_rule_is_about_what_exists(rule: dict[str, Any]) -> None:
    assert set(re.findall(r"smokeglint_\w+", rule["expr"])) <= offered()
    processes = {p.id: p for name in SERVICES for p in importlib.import_module(f"services.{name}.processes").PROCESSES}
    for process, output in re.findall(r'process="([^"]+)"(?:, output="([^"]+)")?', rule["expr"]):
        assert process in processes
        assert not output or output in processes[process].outputs.model_fields
    assert rule["labels"]["severity"] in ("page", "ticket") and len(rule["annotations"]["summary"]) > 30
