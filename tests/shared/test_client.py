"""The client: it tries again where that can help, and only there, and says what the service said."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from shared.client import ProcessClient, is_transient
from shared.errors import JobFailedError
from shared.telemetry import CORRELATION_HEADER

Answer = httpx.Response | Exception
PROBLEM = {"type": "about:blank", "title": "No", "status": 422, "detail": "factor is -1", "field": "factor"}


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that sleeping moves on; the list of naps taken."""
    naps: list[float] = []
    began = time.monotonic()

    def sleep(seconds: float) -> None:
        naps.append(seconds)

    monkeypatch.setattr(time, "sleep", sleep)  # tenacity's, too
    monkeypatch.setattr(time, "monotonic", lambda: began + sum(naps))
    return naps


class Server:
    """Answers with what is next on the list for the method and path; the last one again and again."""

    def __init__(self, **answers: list[Answer | tuple[int, Any]]) -> None:
        self.answers = {"submit": [(201, {"jobID": "j1"})], "status": [done()], "results": [(200, {"count": 2})]}
        self.answers.update({"dismiss": [(200, {})], "ready": [(200, {})], **answers})
        self.requests: list[httpx.Request] = []

    def handle(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        answers = self.answers[kind_of(request)]
        answer = answers.pop(0) if len(answers) > 1 else answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer if isinstance(answer, httpx.Response) else httpx.Response(answer[0], json=answer[1])

    def count(self, kind: str) -> int:
        return sum(kind_of(request) == kind for request in self.requests)

    def client(self, **options: Any) -> ProcessClient:
        return ProcessClient("http://service", transport=httpx.MockTransport(self.handle), **options)


def kind_of(request: httpx.Request) -> str:
    if request.method == "POST":
        return "submit"
    if request.method == "DELETE":
        return "dismiss"
    if request.url.path == "/readyz":
        return "ready"
    return "results" if request.url.path.endswith("/results") else "status"


def state(status: str, progress: float = 0.0, message: str = "") -> tuple[int, Any]:
    return 200, {"jobID": "j1", "status": status, "progress": progress, "message": message}


def done() -> tuple[int, Any]:
    return state("successful", 100.0, "done")


def test_a_job_is_submitted_followed_and_fetched(clock: list[float]) -> None:
    server = Server(status=[state("accepted"), state("running", 40, "points"), state("running", 40, "points"), done()])
    seen: list[tuple[float, str]] = []
    with server.client(correlation_id="cycle-7") as client:
        outputs = client.execute("predict-access", {"b": 1}, progress=lambda *at: seen.append(at))
    assert outputs == {"count": 2}
    assert seen == [(0.0, ""), (40, "points"), (100.0, "done")], "each state once"
    first = server.requests[0]
    assert first.url.path == "/processes/predict-access/execution"
    assert first.headers["Prefer"] == "respond-async"
    assert json.loads(first.content) == {"inputs": {"b": 1}}
    assert {request.headers[CORRELATION_HEADER] for request in server.requests} == {"cycle-7"}
    assert len(clock) == 3
    assert max(clock) <= 0.25


FAULTS: list[Callable[[], Answer | tuple[int, Any]]] = [
    lambda: (500, {"detail": "broken"}),
    lambda: (503, {"detail": "starting"}),
    lambda: (429, {"detail": "slow down"}),
    lambda: httpx.Response(502, text="<html>bad gateway</html>"),
    lambda: httpx.ConnectError("refused"),
    lambda: httpx.ReadTimeout("slow"),
    lambda: httpx.RemoteProtocolError("cut off"),
]


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", ["submit", "status", "results"])
def test_what_may_pass_is_tried_again_with_backoff(
    kind: str, fault: Callable[[], Answer | tuple[int, Any]], clock: list[float]
) -> None:
    server = Server()
    server.answers[kind] = [fault(), fault(), fault(), *server.answers[kind]]
    assert server.client().execute("p", {}) == {"count": 2}
    assert server.count(kind) == 4
    assert len({request.headers["Idempotency-Key"] for request in server.requests if request.method == "POST"}) == 1
    waits = clock[:3]
    assert len(clock) == 3
    assert all(0.2 * 2**k <= wait <= 0.2 * 2**k + 1 for k, wait in enumerate(waits)), "doubling, with jitter up to 1 s"


@pytest.mark.parametrize("status", [400, 404, 409, 413, 422])
@pytest.mark.parametrize("kind", ["submit", "status", "results"])
def test_what_will_not_pass_is_not_tried_again(kind: str, status: int, clock: list[float]) -> None:
    server = Server(**{kind: [(status, {**PROBLEM, "status": status})]})
    with pytest.raises(JobFailedError) as caught:
        server.client().execute("p", {})
    assert server.count(kind) == 1
    assert clock == []
    assert caught.value.problem == {**PROBLEM, "status": status}
    for word in (str(status), "factor is -1", "(field factor)"):
        assert word in str(caught.value)


def test_attempts_are_bounded(clock: list[float]) -> None:
    server = Server(submit=[(503, {"detail": "starting"})])
    with pytest.raises(JobFailedError, match="starting") as caught:
        server.client(attempts=3).execute("p", {})
    assert server.count("submit") == 3
    assert caught.value.problem == {"detail": "starting"}
    server = Server(submit=[httpx.ConnectError("refused")])
    with pytest.raises(httpx.ConnectError):
        server.client(attempts=2).execute("p", {})
    assert server.count("submit") == 2


def test_only_what_can_pass_is_transient() -> None:
    request = httpx.Request("GET", "http://service/")
    for status, expected in {404: False, 422: False, 409: False, 429: True, 500: True, 503: True}.items():
        error = httpx.HTTPStatusError("", request=request, response=httpx.Response(status, request=request))
        assert is_transient(error) is expected
    assert is_transient(httpx.ConnectError(""))
    assert not is_transient(ValueError())
    assert not is_transient(httpx.InvalidURL(""))


@pytest.mark.parametrize(("status", "code"), [("failed", 422), ("failed", 500), ("dismissed", 410)])
def test_a_failed_job_s_problem_is_carried_and_asked_for_once(status: str, code: int, clock: list[float]) -> None:
    problem = {**PROBLEM, "status": code}
    server = Server(status=[state(status)], results=[(code, problem)])
    with pytest.raises(JobFailedError) as caught:
        server.client().execute("p", {})
    assert caught.value.problem == problem
    assert server.count("results") == 1
    assert clock == []


def test_a_problem_that_is_no_json_is_carried_as_text() -> None:
    server = Server(submit=[httpx.Response(404, text="nothing here")])
    with pytest.raises(JobFailedError, match="nothing here") as caught:
        server.client().execute("p", {})
    assert caught.value.problem == {"status": 404, "detail": "nothing here"}


def test_a_job_that_takes_too_long_is_dismissed(clock: list[float]) -> None:
    server = Server(status=[state("running", 1.0)])
    with pytest.raises(TimeoutError, match=r"j1.*5 s"):
        server.client().execute("p", {}, limit_s=5)
    last = server.requests[-1]
    assert (last.method, last.url.path) == ("DELETE", "/jobs/j1")
    assert server.count("dismiss") == 1
    assert 5 < sum(clock) < 5.5


def key_of(process: str, inputs: dict[str, Any]) -> str:
    server = Server()
    server.client().execute(process, inputs)
    return server.requests[0].headers["Idempotency-Key"]


def test_the_idempotency_key_is_that_of_the_request() -> None:
    key = key_of("p", {"a": 1, "b": {"c": 2, "d": [1, 2]}})
    assert key == key_of("p", {"b": {"d": [1, 2], "c": 2}, "a": 1})
    others = [key_of("q", {"a": 1}), key_of("p", {"a": 1}), key_of("p", {"a": 2}), key_of("p", {"a": [1]})]
    assert len({key, *others}) == 5


def test_waiting_for_a_service_outlasts_its_start(clock: list[float]) -> None:
    server = Server(ready=[httpx.ConnectError("refused"), (503, {}), (200, {})])
    server.client().wait_ready()
    assert server.count("ready") == 3
    with pytest.raises(TimeoutError, match="http://service"):
        Server(ready=[(503, {})]).client().wait_ready(limit_s=3)


def test_a_client_waits_as_long_as_it_is_asked_to(clock: list[float]) -> None:
    busy = httpx.Response(429, json={"detail": "2 jobs already"}, headers={"Retry-After": "7"})
    endless = httpx.Response(429, json={"detail": "2 jobs already"}, headers={"Retry-After": "86400"})
    server = Server(submit=[busy, endless, (201, {"jobID": "j1"})])
    assert server.client().execute("scale", {}) == {"count": 2}
    assert clock[0] >= 7 and clock[1] == 60


def test_a_client_shows_the_key_it_was_given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "key").write_text("sg_from_file\n")
    given = []
    for environment in ({}, {"SMOKEGLINT_API_KEY_FILE": str(tmp_path / "key")}, {"SMOKEGLINT_API_KEY": "sg_plain"}):
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        server = Server()
        server.client().execute("scale", {})
        given.append(server.requests[0].headers.get("Authorization"))
    assert given == [None, "Bearer sg_from_file", "Bearer sg_plain"]
