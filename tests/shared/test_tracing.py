"""Traces: off by default; one trace from a loop's step by the request to the job, the correlation id on each."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from fastapi.testclient import TestClient

from shared import tracing
from shared.client import ProcessClient

REPOSITORY = Path(__file__).resolve().parents[2]
HAS_SDK = importlib.util.find_spec("opentelemetry.sdk") is not None


@pytest.mark.parametrize("hidden", ["opentelemetry", "opentelemetry.sdk", "opentelemetry.exporter"])
def test_without_the_packages_all_goes_on_untraced(hidden: str) -> None:
    script = (
        f"import sys; sys.modules['{hidden}'] = None\n"
        "import os; os.environ['OTEL_EXPORTER_OTLP_ENDPOINT'] = 'http://127.0.0.1:9'\n"
        "from shared import tracing\n"
        "assert tracing.configure_tracing('toy') is False\n"
        "with tracing.span('step', tracing.current(), process='p'): tracing.mark_request()\n"
        "print(tracing.trace_headers())"
    )
    run = subprocess.run([sys.executable, "-c", script], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "{}"
    assert "a package is missing" in run.stdout + run.stderr


def test_without_an_endpoint_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in tracing.ENDPOINTS:
        monkeypatch.delenv(name, raising=False)
    assert tracing.configure_tracing("toy") is False
    assert tracing.trace_headers() == {}


if HAS_SDK:  # an extra of its own
    from opentelemetry import trace
    from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    @pytest.fixture
    def exported(monkeypatch: pytest.MonkeyPatch) -> Iterator[InMemorySpanExporter]:
        exporter, provider = InMemorySpanExporter(), TracerProvider()
        provider.add_span_processor(SimpleSpanProcessor(exporter))
        monkeypatch.setattr(trace, "_TRACER_PROVIDER", provider)
        yield exporter
        provider.shutdown()

    def test_a_step_its_request_and_its_job_are_one_trace(exported: InMemorySpanExporter, toy: TestClient) -> None:
        passed_on = httpx.MockTransport(
            lambda request: httpx.Response(
                (
                    answer := toy.request(
                        request.method, request.url.path, content=request.content, headers=dict(request.headers)
                    )
                ).status_code,
                content=answer.content,
                headers={"Content-Type": answer.headers["Content-Type"]},
            )
        )
        with (
            tracing.span("step sleep", process="sleep"),
            ProcessClient("http://testserver", correlation_id="fires-1", transport=passed_on) as client,
        ):
            client.execute("sleep", {"seconds": 0})
        spans = {span.name: span for span in exported.get_finished_spans()}
        step, request, job = spans["step sleep"], _request(exported), spans["job sleep"]
        above = {span.context.span_id: span.parent for span in exported.get_finished_spans()}
        assert step.context.span_id == request.parent.span_id
        lineage = [job.parent.span_id]
        while parent := above.get(lineage[-1]):
            lineage.append(parent.span_id)
        assert lineage[-2:] == [request.context.span_id, step.context.span_id]
        assert {span.context.trace_id for span in (step, request, job)} == {step.context.trace_id}
        assert request.attributes["smokeglint.correlation_id"] == "fires-1"
        assert (
            job.attributes["smokeglint.correlation_id"] == "fires-1" and job.attributes["smokeglint.process"] == "sleep"
        )

    def _request(exported: InMemorySpanExporter) -> ReadableSpan:
        (posted,) = [span for span in exported.get_finished_spans() if span.name.startswith("POST ")]
        return posted
