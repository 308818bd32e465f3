"""Prometheus metrics of a service: jobs by process and outcome, their duration, the queue."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from datetime import datetime
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

_BUCKETS = (0.1, 0.5, 1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600)


class ServiceMetrics:
    """One registry a service, so that several can live in one interpreter (tests do that)."""

    def __init__(self, service: str) -> None:
        self._registry = CollectorRegistry()
        self._service = service
        labels = ("service", "process")
        self._jobs = Counter("smokeglint_jobs", "Jobs ended", (*labels, "status"), registry=self._registry)
        self._seconds = Histogram(
            "smokeglint_job_seconds", "Duration of jobs", labels, buckets=_BUCKETS, registry=self._registry
        )
        self._outputs = Gauge(
            "smokeglint_output",
            "Last value of a process's numeric output",
            (*labels, "output"),
            registry=self._registry,
        )
        self._oldest = Gauge(
            "smokeglint_oldest_input_timestamp_seconds",
            "Time of the oldest datum behind the last product",
            labels,
            registry=self._registry,
        )
        self._simulated = Gauge(
            "smokeglint_simulated_share", "Simulated share of the last product", labels, registry=self._registry
        )
        self._bytes = Counter("smokeglint_written_bytes", "Bytes of finished products", labels, registry=self._registry)
        self._queue = Gauge("smokeglint_jobs_queued", "Jobs waiting", ("service",), registry=self._registry)

    def timing(self, process: str) -> AbstractContextManager[object]:
        """Observe the duration of a job."""
        return self._seconds.labels(self._service, process).time()

    def count(self, process: str, status: str) -> None:
        """Count an ended job."""
        self._jobs.labels(self._service, process, status).inc()

    def describe(self, process: str, outputs: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
        """Show what a finished job made: its numbers (gap, counts, …), its size, the age of what it rests on."""
        for name, value in outputs.items():
            if isinstance(value, int | float):
                self._outputs.labels(self._service, process, name).set(float(value))
        if not facts:
            return
        self._bytes.labels(self._service, process).inc(facts["bytes"])
        self._simulated.labels(self._service, process).set(facts["simulated_share"])
        if facts["oldest_input"]:
            oldest = datetime.fromisoformat(facts["oldest_input"].replace("Z", "+00:00"))
            self._oldest.labels(self._service, process).set(oldest.timestamp())

    def watch_queue(self, length: Callable[[], float]) -> None:
        """Let the queue gauge read its value when it is asked."""
        self._queue.labels(self._service).set_function(length)

    def page(self) -> bytes:
        """The metrics in Prometheus' text format."""
        return generate_latest(self._registry)
