"""Requests made up from each service's OpenAPI document: whatever is sent, no answer is a fault of the service."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
import schemathesis
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis import checks

from shared.process.app import create_app
from shared.settings import ServiceSettings

SERVICES = ("access", "prioritization", "planning", "retrieval", "arrival")
PATHS = 12  # operations of the process API
_SETTINGS = settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)


@pytest.mark.parametrize("name", SERVICES)
def test_no_made_up_request_breaks_a_service(name: str, tmp_path: Path) -> None:
    processes = importlib.import_module(f"services.{name}.processes").PROCESSES
    app = create_app(name, name, processes, settings=ServiceSettings(artifact_root=str(tmp_path)))
    with TestClient(app, raise_server_exceptions=False):  # starts the service
        schema = schemathesis.openapi.from_asgi("/api", app)
        operations = [operation.ok() for operation in schema.get_all_operations()]
        assert len(operations) >= PATHS
        for operation in operations:
            if operation.path != "/readyz":  # 503 until a worker is warm is its very purpose
                _try(operation)
        _try_inputs(TestClient(app, raise_server_exceptions=False), processes)


def _try(operation: schemathesis.APIOperation) -> None:
    @_SETTINGS
    @given(case=operation.as_strategy())
    def sent(case: schemathesis.Case) -> None:
        case.call_and_validate(checks=[checks.not_a_server_error])

    sent()


def _try_inputs(client: TestClient, processes: list) -> None:
    """Bodies that fit no process: named, never a fault."""
    for process in processes:
        for inputs in ({}, {"nonsense": 1}, dict.fromkeys(process.inputs.model_fields, "\x00"), []):
            answer = client.post(f"/processes/{process.id}/execution", json={"inputs": inputs})
            assert answer.status_code == 422, (process.id, inputs, answer.text)
            assert answer.headers["content-type"] == "application/problem+json"
