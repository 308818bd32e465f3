"""Prometheus metrics of a service: jobs by process and outcome, their duration, the queue."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

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
        self._queue = Gauge("smokeglint_jobs_queued", "Jobs waiting", ("service",), registry=self._registry)

    def timing(self, process: str) -> AbstractContextManager[object]:
        """Observe the duration of a job."""
        return self._seconds.labels(self._service, process).time()

    def count(self, process: str, status: str) -> None:
        """Count an ended job."""
        self._jobs.labels(self._service, process, status).inc()

    def watch_queue(self, length: Callable[[], float]) -> None:
        """Let the queue gauge read its value when it is asked."""
        self._queue.labels(self._service).set_function(length)

    def page(self) -> bytes:
        """The metrics in Prometheus' text format."""
        return generate_latest(self._registry)
