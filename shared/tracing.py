"""OpenTelemetry traces: off unless ``OTEL_EXPORTER_OTLP_ENDPOINT`` says where to, and never needed.

Spans of requests come from FastAPI itself; here are those of jobs and of the loop's steps, and what ties them together:
the trace's context in the headers between them, and the correlation id on each.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from shared.telemetry import correlation_id, logger

try:
    from opentelemetry import context, propagate, trace
except ImportError:  # then nothing is traced, and nothing else changes
    trace = None  # type: ignore[assignment]

ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
_SDK = ("trace", "resources", "trace.export")
_CORRELATION = "smokeglint.correlation_id"


def configure_tracing(service: str) -> bool:
    """Send this process's spans to where the environment says; whether they are sent.

    Without the packages ``opentelemetry-sdk`` and ``opentelemetry-exporter-otlp-proto-http`` a line in the log says so.
    """
    if not any(os.environ.get(name) for name in ENDPOINTS):
        return False
    try:
        sdk, resources, export = (import_module(f"opentelemetry.sdk.{name}") for name in _SDK)
        otlp = import_module("opentelemetry.exporter.otlp.proto.http.trace_exporter")
    except ImportError as error:
        logger().warning("no traces: a package is missing", error=str(error))
        return False
    provider = sdk.TracerProvider(resource=resources.Resource.create({"service.name": f"smokeglint-{service}"}))
    provider.add_span_processor(export.BatchSpanProcessor(otlp.OTLPSpanExporter()))
    trace.set_tracer_provider(provider)
    return True


@contextmanager
def span(name: str, parent: Any = None, **attributes: str) -> Iterator[None]:
    """A span around what is done inside, below ``parent`` (see ``current``) or the span that is open here."""
    if trace is None:
        yield
        return
    told = {f"smokeglint.{key}": value for key, value in attributes.items()}
    tracer = trace.get_tracer("smokeglint")
    with tracer.start_as_current_span(name, context=parent, attributes={_CORRELATION: correlation_id.get(), **told}):
        yield


def current() -> Any:
    """The trace that is open here, to go on with in another thread."""
    return None if trace is None else context.get_current()


def mark_request() -> None:
    """Put the correlation id on the span of the request that is being answered."""
    if trace is not None:
        trace.get_current_span().set_attribute(_CORRELATION, correlation_id.get())


def trace_headers() -> dict[str, str]:
    """What a request must carry so that its spans join the trace that is open here; empty if none is."""
    headers: dict[str, str] = {}
    if trace is not None:
        propagate.inject(headers)
    return headers
