"""The process API as a client sees it: what OGC API – Processes, Part 1 asks, and what happens when things go wrong."""

from __future__ import annotations

import json
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import pytest
from fastapi.testclient import TestClient

from shared.contracts import tables
from shared.contracts.schema import read_attributes, read_table
from shared.errors import UnavailableError
from shared.process import routes

EXECUTE = "/processes/scale-targets/execution"


def wait_for(client: TestClient, job_id: str, *statuses: str) -> dict[str, Any]:
    for _ in range(400):
        status: dict[str, Any] = client.get(f"/jobs/{job_id}").json()
        if status["status"] in statuses:
            return status
        time.sleep(0.05)
    raise AssertionError(f"job never became {statuses}: {status}")


def wait_ready(client: TestClient) -> None:
    for _ in range(400):
        if client.get("/readyz").status_code == 200:
            return
        time.sleep(0.05)
    raise AssertionError("the service never became ready")


def leftovers(root: Path) -> list[str]:
    """Files that are neither inputs, nor the job database, nor part of a step with a manifest."""
    found = [
        path for path in root.rglob("*") if path.is_file() and ".jobs" not in path.parts and path.parent.name != "case"
    ]
    return [str(path) for path in found if not (path.parent / "manifest.json").exists()]


def test_pages_of_part_1_link_to_each_other(toy: TestClient) -> None:
    landing = toy.get("/").json()
    for link in landing["links"]:
        assert toy.get(link["href"]).status_code == 200, link
    assert any("conf/core" in name for name in toy.get("/conformance").json()["conformsTo"])
    listed = toy.get("/processes").json()["processes"]
    assert [entry["id"] for entry in listed] == ["scale-targets", "sleep"]
    described = toy.get(listed[0]["links"][0]["href"]).json()
    assert described["inputs"]["factor"]["schema"]["maximum"] == 10
    assert described["inputs"]["targets"]["minOccurs"] == 1
    assert "$ref" not in json.dumps(described)
    assert toy.get("/healthz").json() == {"status": "alive"}


def test_sync_execution_answers_with_checked_artifacts(toy: TestClient, targets_file: Path) -> None:
    body = {"inputs": {"targets": {"href": targets_file.as_uri()}, "factor": 2.0, "case": "c", "cycle": "d"}}
    answer = toy.post(EXECUTE, json=body)
    assert answer.status_code == 200, answer.text
    made = Path(answer.json()["targets"]["href"].removeprefix("file://"))
    assert made.parts[-5:-2] == ("c", "d", "scale-targets")
    assert read_table(made, tables.TARGETS)["priority"].tolist() == [2.0, 0.5]
    assert read_attributes(made)["simulated"] is False
    counted = 'smokeglint_jobs_total{process="scale-targets",service="toy",status="successful"}'
    page = toy.get("/metrics").text
    assert counted in page
    assert 'smokeglint_output{output="count",process="scale-targets",service="toy"} 2.0' in page
    assert 'smokeglint_simulated_share{process="scale-targets",service="toy"} 0.0' in page
    written = re.search(r'smokeglint_written_bytes_total{process="scale-targets",service="toy"} (\S+)', page)
    assert written is not None and float(written[1]) >= made.stat().st_size


def test_async_execution_reports_location_and_results(toy: TestClient, targets_file: Path) -> None:
    body = {"inputs": {"targets": {"href": "case/targets.parquet"}}}
    answer = toy.post(EXECUTE, json=body, headers={"Prefer": "respond-async"})
    assert answer.status_code == 201
    job_id = answer.headers["Location"].rsplit("/", 1)[1]
    status = wait_for(toy, job_id, "successful")
    assert status["progress"] == 100
    assert toy.get(f"/jobs/{job_id}/results").json()["count"] == 2
    assert toy.get("/jobs").json()["jobs"][0]["jobID"] == job_id


def test_a_finished_step_is_answered_from_its_manifest(toy: TestClient, targets_file: Path) -> None:
    body = {"inputs": {"targets": {"href": targets_file.as_uri()}}}
    first = toy.post(EXECUTE, json=body).json()
    made = Path(first["targets"]["href"].removeprefix("file://"))
    before = made.stat().st_mtime_ns
    assert toy.post(EXECUTE, json=body).json() == first
    assert made.stat().st_mtime_ns == before
    made.write_bytes(b"tampered")
    assert toy.post(EXECUTE, json=body).json() == first, "a damaged artifact is rebuilt"
    assert read_table(made, tables.TARGETS)["priority"].tolist() == [1.0, 0.25]


@pytest.mark.parametrize(
    ("path", "content", "status", "word"),
    [
        ("/processes/unknown/execution", '{"inputs": {}}', 404, "unknown"),
        (EXECUTE, "{not json", 400, "body"),
        (EXECUTE, "[1, 2]", 400, "object"),
        (EXECUTE, '{"inputs": {}}', 422, "targets"),
        (EXECUTE, '{"inputs": {"targets": {"href": "case/targets.parquet"}, "factor": -1}}', 422, "factor"),
        (EXECUTE, '{"inputs": {"targets": {"href": "case/targets.parquet"}, "colour": 1}}', 422, "colour"),
        (EXECUTE, '{"inputs": {"targets": {"href": "file:///etc/passwd"}}}', 422, "/etc/passwd"),
        (EXECUTE, '{"inputs": {"targets": {"href": "../../etc/passwd"}}}', 422, "etc/passwd"),
        (EXECUTE, '{"inputs": {"targets": {"href": "http://example.org/x"}}}', 422, "example.org"),
        (EXECUTE, '{"inputs": {"targets": {"href": "file://elsewhere/x"}}}', 422, "elsewhere"),
        (EXECUTE, '{"inputs": {"targets": {"href": "case/missing.parquet"}}}', 422, "missing.parquet"),
        (EXECUTE, '{"inputs": {"targets": {"href": "case/targets.parquet"}, "case": "../up"}}', 422, "case"),
        (
            EXECUTE,
            '{"inputs": {"targets": {"href": "case/targets.parquet"}}, "outputs": {"colour": {}}}',
            422,
            "colour",
        ),
        ("/jobs/none/results", "", 404, "none"),
    ],
)
def test_bad_requests_name_the_field_and_leave_nothing(
    toy: TestClient, root: Path, targets_file: Path, path: str, content: str, status: int, word: str
) -> None:
    answer = toy.post(path, content=content) if content else toy.get(path)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["status"] == status
    assert word in answer.text
    assert leftovers(root) == []


def test_a_symlink_out_of_the_roots_is_refused(toy: TestClient, root: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.parquet").write_bytes(b"secret")
    (root / "case" / "link.parquet").symlink_to(tmp_path / "secret.parquet")
    answer = toy.post(EXECUTE, json={"inputs": {"targets": {"href": "case/link.parquet"}}})
    assert answer.status_code == 422
    assert "outside" in answer.json()["detail"]


def test_a_changed_input_is_refused(toy: TestClient, targets_file: Path) -> None:
    body = {"inputs": {"targets": {"href": targets_file.as_uri(), "sha256": "0" * 64}}}
    answer = toy.post(EXECUTE, json=body)
    assert answer.status_code == 422
    assert answer.json()["field"] == "sha256"


def test_a_broken_contract_names_column_and_row(toy: TestClient, targets_file: Path, root: Path) -> None:
    import pandas as pd

    broken = targets_file.with_name("broken.parquet")
    pd.read_parquet(targets_file).drop(columns="kind").to_parquet(broken)
    answer = toy.post(EXECUTE, json={"inputs": {"targets": {"href": broken.as_uri()}}})
    assert (answer.status_code, answer.json()["field"]) == (422, "kind")
    assert leftovers(root) == []


def test_an_idempotency_key_is_one_job_until_it_fails(toy: TestClient, targets_file: Path) -> None:
    headers = {"Prefer": "respond-async", "Idempotency-Key": "k1"}
    body = {"inputs": {"targets": {"href": "case/targets.parquet"}}}
    first = toy.post(EXECUTE, json=body, headers=headers).json()["jobID"]
    assert toy.post(EXECUTE, json=body, headers=headers).json()["jobID"] == first
    assert toy.post(EXECUTE, json={"inputs": {**body["inputs"], "factor": 3}}, headers=headers).status_code == 409
    crash = {"inputs": {"seconds": 0, "outcome": "crash"}}
    lost = toy.post("/processes/sleep/execution", json=crash, headers={**headers, "Idempotency-Key": "k2"}).json()[
        "jobID"
    ]
    wait_for(toy, lost, "failed")
    again = toy.post("/processes/sleep/execution", json=crash, headers={**headers, "Idempotency-Key": "k2"}).json()[
        "jobID"
    ]
    assert again != lost
    wait_for(toy, again, "failed")


def test_a_remembered_success_whose_files_are_damaged_is_made_anew(toy: TestClient, targets_file: Path) -> None:
    headers, body = {"Idempotency-Key": "k3"}, {"inputs": {"targets": {"href": "case/targets.parquet"}}}
    first = toy.post(EXECUTE, json=body, headers=headers).json()
    made = Path(first["targets"]["href"].removeprefix("file://"))
    made.unlink()
    assert toy.post(EXECUTE, json=body, headers=headers).json() == first
    assert made.is_file()


def test_a_killed_worker_costs_its_job_only(toy: TestClient, root: Path, targets_file: Path) -> None:
    answer = toy.post("/processes/sleep/execution", json={"inputs": {"seconds": 0, "outcome": "crash"}})
    assert answer.status_code == 500
    assert "worker" in answer.json()["title"].lower()
    assert leftovers(root) == []
    assert toy.post(EXECUTE, json={"inputs": {"targets": {"href": "case/targets.parquet"}}}).status_code == 200


@pytest.mark.parametrize("outcome", ["full-disk", "full-at-manifest"])
def test_a_full_disk_costs_the_job_and_leaves_nothing(toy: TestClient, root: Path, outcome: str) -> None:
    before = {path for path in root.rglob("*") if path.is_dir() and path.parent.name == "sleep"}
    answer = toy.post("/processes/sleep/execution", json={"inputs": {"seconds": 0, "outcome": outcome}})
    assert (answer.status_code, answer.json()["title"]) == (507, "No room for the products")
    assert leftovers(root) == []
    assert {path for path in root.rglob("*") if path.is_dir() and path.parent.name == "sleep"} == before
    assert toy.post("/processes/sleep/execution", json={"inputs": {"seconds": 0}}).status_code == 200


def test_a_register_that_is_away_for_a_while_costs_nothing(toy: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    register = toy.app.state.service.jobs  # type: ignore[attr-defined]
    update, refused = register.update, []

    def away(job_id: str, status: str, **values: Any) -> bool:
        if len(refused) < 4:
            refused.append(status)
            raise UnavailableError("away")
        return bool(update(job_id, status, **values))

    monkeypatch.setattr(register, "update", away)
    body = {"inputs": {"seconds": 0.02}}
    assert toy.post("/processes/sleep/execution", json=body).status_code == 200
    assert refused[:2] == ["running", "running"]


def test_a_job_whose_acceptance_was_lost_on_the_way_is_run(toy: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    register = toy.app.state.service.jobs  # type: ignore[attr-defined]
    submit, body, headers = register.submit, {"inputs": {"seconds": 0.01}}, {"Idempotency-Key": "lost"}

    def lose(*asked: Any) -> Any:
        submit(*asked)
        raise UnavailableError("the answer was lost")

    monkeypatch.setattr(register, "submit", lose)
    refused = toy.post("/processes/sleep/execution", json=body, headers=headers)
    assert (refused.status_code, refused.headers["Retry-After"]) == (503, "1")
    monkeypatch.setattr(register, "submit", submit)
    assert toy.post("/processes/sleep/execution", json=body, headers=headers).status_code == 200


def test_a_fault_keeps_its_secret(toy: TestClient, root: Path) -> None:
    answer = toy.post("/processes/sleep/execution", json={"inputs": {"seconds": 0, "outcome": "fault"}})
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert leftovers(root) == []


def test_a_running_and_a_waiting_job_can_be_dismissed(toy: TestClient, root: Path, targets_file: Path) -> None:
    headers = {"Prefer": "respond-async"}
    running = toy.post("/processes/sleep/execution", json={"inputs": {"seconds": 50}}, headers=headers).json()["jobID"]
    waiting = toy.post("/processes/sleep/execution", json={"inputs": {"seconds": 49}}, headers=headers).json()["jobID"]
    wait_for(toy, running, "running")
    assert toy.get(f"/jobs/{running}/results").status_code == 404
    assert toy.delete(f"/jobs/{waiting}").json()["status"] == "dismissed"
    assert toy.delete(f"/jobs/{running}").json()["status"] == "dismissed"
    assert toy.get(f"/jobs/{running}/results").status_code == 410
    assert toy.post(EXECUTE, json={"inputs": {"targets": {"href": "case/targets.parquet"}}}).status_code == 200
    assert leftovers(root) == []


def test_reads_are_answered_while_a_job_runs(toy: TestClient) -> None:
    body = {"inputs": {"seconds": 1.0}}
    answers: list[int] = []
    thread = threading.Thread(
        target=lambda: answers.append(toy.post("/processes/sleep/execution", json=body).status_code)
    )
    thread.start()
    assert toy.get("/processes").status_code == 200
    thread.join()
    assert answers == [200]


def test_many_readers_at_once_meet_no_error(toy: TestClient) -> None:
    pages = ["/", "/processes", "/processes/sleep", "/jobs", "/metrics", "/readyz"] * 15
    wait_ready(toy)
    with ThreadPoolExecutor(50) as readers:
        assert set(readers.map(lambda page: toy.get(page).status_code, pages)) == {200}


def test_jobs_come_in_pages(toy: TestClient) -> None:
    every = toy.get("/jobs").json()["jobs"]
    assert len(every) > 3
    first = toy.get("/jobs", params={"limit": 2}).json()
    following = {link["rel"]: link["href"] for link in first["links"]}["next"]
    assert first["jobs"] == every[:2] and toy.get(following).json()["jobs"] == every[2:4]
    assert toy.get("/jobs", params={"limit": 0}).status_code == 422


def test_the_correlation_id_is_kept_or_made(toy: TestClient) -> None:
    assert toy.get("/", headers={"X-Correlation-ID": "cycle-7"}).headers["X-Correlation-ID"] == "cycle-7"
    forged = toy.get("/", headers={"X-Correlation-ID": 'x" {}'}).headers["X-Correlation-ID"]
    assert forged.isalnum()


def test_a_large_body_is_refused(toy: TestClient) -> None:
    answer = toy.post(EXECUTE, content=b'{"inputs": {"x": "' + b"a" * 1_100_000 + b'"}}')
    assert answer.status_code == 413


@pytest.mark.parametrize("at_once", [True, False])
def test_a_register_that_may_wait_is_asked_in_a_thread(toy: TestClient, at_once: bool) -> None:
    async def where() -> bool:
        service: Any = SimpleNamespace(answers_at_once=at_once)
        return await routes._read(service, lambda _: threading.get_ident()) == threading.get_ident()

    assert anyio.run(where) == at_once
    assert toy.app.state.service.answers_at_once  # type: ignore[attr-defined]
