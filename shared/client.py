"""The HTTP client of the process API: submit, poll, fetch, with retries where trying again can help."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import httpx
from tenacity import RetryCallState, Retrying, retry_if_exception, stop_after_attempt, wait_exponential_jitter

from shared.errors import JobFailedError
from shared.process.declaration import body_hash
from shared.telemetry import CORRELATION_HEADER
from shared.tracing import trace_headers

Progress = Callable[[float, str], None]
_POLL_FIRST_S, _POLL_LAST_S = 0.05, 0.25
_BACKOFF = wait_exponential_jitter(initial=0.2, max=5.0)
_LONGEST_PAUSE_S = 60.0


def is_transient(error: BaseException) -> bool:
    """Whether trying again can help: transport errors, 429 and 5xx only."""
    if isinstance(error, httpx.HTTPStatusError):
        return error.response.status_code == 429 or error.response.status_code >= 500
    return isinstance(error, httpx.TransportError)


class ProcessClient:
    """Talks to one service. ``attempts`` bounds the tries of each request.

    ``api_key`` is sent as a bearer credential; by default the one of ``SMOKEGLINT_API_KEY``, or in the file that
    ``SMOKEGLINT_API_KEY_FILE`` names.
    """

    def __init__(
        self,
        base_url: str,
        *,
        correlation_id: str = "",
        timeout_s: float = 30.0,
        attempts: int = 6,
        api_key: str | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        headers = {CORRELATION_HEADER: correlation_id} if correlation_id else {}
        if key := credential_of_environment() if api_key is None else api_key:
            headers["Authorization"] = f"Bearer {key}"
        self._http = httpx.Client(base_url=base_url, headers=headers, timeout=timeout_s, transport=transport)
        self._attempts = attempts

    def __enter__(self) -> ProcessClient:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def execute(
        self, process: str, inputs: Mapping[str, Any], *, limit_s: float = 3600.0, progress: Progress | None = None
    ) -> dict[str, Any]:
        """Submit a job, follow it and return its outputs.

        The idempotency key is derived from the request, so a retry after a lost answer finds the same job.
        Raises JobFailedError with the job's problem document, TimeoutError after ``limit_s`` (the job is dismissed).
        """
        body = json.dumps({"inputs": inputs}, sort_keys=True, default=str).encode()
        key = body_hash(process, body)
        headers = {"Prefer": "respond-async", "Idempotency-Key": key, "Content-Type": "application/json"}
        job = self._request("POST", f"/processes/{process}/execution", content=body, headers=headers)
        return self._follow(job["jobID"], limit_s, progress)

    def _follow(self, job_id: str, limit_s: float, progress: Progress | None) -> dict[str, Any]:
        deadline, pause_s, seen = time.monotonic() + limit_s, _POLL_FIRST_S, (-1, "")
        while True:
            status = self._request("GET", f"/jobs/{job_id}")
            if progress and (status["progress"], status["message"]) != seen:
                seen = (status["progress"], status["message"])
                progress(*seen)
            if status["status"] in ("successful", "failed", "dismissed"):
                return self._request("GET", f"/jobs/{job_id}/results", retried=status["status"] == "successful")
            if time.monotonic() > deadline:
                self._request("DELETE", f"/jobs/{job_id}")
                raise TimeoutError(f"job {job_id} did not end within {limit_s:.0f} s and was dismissed")
            time.sleep(pause_s)
            pause_s = min(pause_s * 1.5, _POLL_LAST_S)

    def wait_ready(self, limit_s: float = 120.0) -> None:
        """Wait until the service can work; TimeoutError if it cannot within ``limit_s``."""
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            try:
                if self._http.get("/readyz").status_code == 200:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.1)
        raise TimeoutError(f"the service at {self._http.base_url} was not ready within {limit_s:.0f} s")

    def _request(self, method: str, path: str, *, retried: bool = True, **options: Any) -> dict[str, Any]:
        retrying = Retrying(
            retry=retry_if_exception(is_transient),
            wait=_pause_s,
            stop=stop_after_attempt(self._attempts if retried else 1),
            reraise=True,
        )
        try:
            return retrying(self._once, method, path, **options)
        except httpx.HTTPStatusError as error:
            raise JobFailedError(_text_of(error.response), _problem_in(error.response)) from error

    def _once(self, method: str, path: str, **options: Any) -> dict[str, Any]:
        headers = {**options.pop("headers", {}), **trace_headers()}
        response = self._http.request(method, path, headers=headers, **options)
        response.raise_for_status()
        document: dict[str, Any] = response.json()
        return document


def credential_of_environment() -> str:
    """The API key or token that this process was given; empty if none."""
    if key := os.environ.get("SMOKEGLINT_API_KEY", ""):
        return key
    file = os.environ.get("SMOKEGLINT_API_KEY_FILE", "")
    return Path(file).read_text(encoding="utf-8").strip() if file else ""


def _pause_s(state: RetryCallState) -> float:
    """Ever longer with a jitter, and at least as long as the service asks (``Retry-After``)."""
    error = state.outcome.exception() if state.outcome else None
    asked = error.response.headers.get("Retry-After", "") if isinstance(error, httpx.HTTPStatusError) else ""
    return max(_BACKOFF(state), min(float(asked), _LONGEST_PAUSE_S) if asked.isdigit() else 0.0)


def _problem_in(response: httpx.Response) -> dict[str, Any]:
    try:
        document = response.json()
    except ValueError:
        document = None
    return document if isinstance(document, dict) else {"status": response.status_code, "detail": response.text[:500]}


def _text_of(response: httpx.Response) -> str:
    document = _problem_in(response)
    where = f" (field {document['field']})" if document.get("field") else ""
    return (
        f"{response.request.method} {response.request.url.path} answered {response.status_code}: "
        + str(document.get("detail", document.get("title", "")))
        + where
    )
