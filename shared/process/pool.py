"""The service's side of its workers: a queue, a thread for each worker process, replacement of killed ones."""

from __future__ import annotations

import atexit
import contextlib
import json
import multiprocessing
import queue
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

from shared.errors import UnavailableError
from shared.process.jobs import Job, JobRegister, Status
from shared.process.metrics import ServiceMetrics
from shared.process.problem import problem
from shared.process.worker import WorkerSettings, worker_main
from shared.settings import ServiceSettings
from shared.telemetry import correlation_id, logger
from shared.tracing import current, span

Answer = TypeVar("Answer")
_REGISTER_PAUSE_S = 0.5
_SPAWN = multiprocessing.get_context("spawn")  # a forked child of a threaded server inherits held locks


class WorkerPool:
    """Runs queued jobs in worker processes; a killed worker costs its job only, and is replaced."""

    def __init__(
        self,
        service: str,
        module: str,
        settings: ServiceSettings,
        jobs: JobRegister,
        metrics: ServiceMetrics,
        discard: Callable[[str], None],
    ) -> None:
        self._jobs = jobs
        self._discard = discard
        self._metrics = metrics
        self._worker = WorkerSettings(service, module, settings.roots, settings.input_limits, settings.log_level)
        self._queue: queue.Queue[Job | None] = queue.Queue()
        self._ended: dict[str, threading.Event] = {}
        self._traces: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._slots = [_Slot(self) for _ in range(settings.workers)]

    def start(self) -> None:
        """Start the workers; they get warm while the service already answers."""
        atexit.register(self.stop)  # the interpreter would wait for them for ever
        for slot in self._slots:
            slot.start()

    def stop(self) -> None:
        """End the workers; running jobs fail at the next start."""
        atexit.unregister(self.stop)
        for slot in self._slots:
            slot.stop()
        for _ in self._slots:
            self._queue.put(None)

    @property
    def ready(self) -> bool:
        """Whether a worker has loaded its models."""
        return any(slot.ready and slot.is_alive() for slot in self._slots)

    @property
    def queued(self) -> int:
        return self._queue.qsize()

    def submit(self, job: Job) -> bool:
        """Queue a job; False if it waits or runs here already."""
        with self._lock:
            if job.id in self._ended:
                return False
            self._ended[job.id] = threading.Event()
            self._traces[job.id] = current()
        self._queue.put(job)
        return True

    def wait(self, job_id: str, timeout_s: float | None = None) -> Job:
        """The job once it has ended (or as it stands after the timeout)."""
        event = self._ended.get(job_id)
        if event is not None:
            event.wait(timeout_s)
        return self._jobs.get(job_id)

    def dismiss(self, job_id: str) -> None:
        """Stop a job: one that waits is never started, one that runs loses its worker."""
        self._jobs.update(job_id, "dismissed", message="dismissed on request")
        for slot in self._slots:
            slot.kill_if_running(job_id)
        self._finish(job_id)

    def _finish(self, job_id: str) -> None:
        with self._lock:
            event = self._ended.pop(job_id, None)
            self._traces.pop(job_id, None)
        if event is not None:
            event.set()

    def _take(self) -> Job | None:
        return self._queue.get()


class _Slot(threading.Thread):
    """A thread that owns one worker process."""

    def __init__(self, pool: WorkerPool) -> None:
        super().__init__(name="worker-slot", daemon=True)
        self._pool = pool
        self._lock = threading.Lock()
        self._process: SpawnProcess | None = None
        self._connection: Connection | None = None
        self._job_id = ""
        self._stopping = False
        self.ready = False

    def run(self) -> None:
        self._renew_worker()
        while (job := self._pool._take()) is not None and not self._stopping:
            correlation_id.set(job.correlation_id)
            try:
                self._serve(job)
            except Exception as error:  # whatever it is must not end the slot, which no one restarts
                logger().error("job lost by its slot", process=job.process, job=job.id, error=repr(error))
                self._abandon_worker()
                with contextlib.suppress(Exception):
                    told = problem(500, "about:blank", "The job was lost", "The service met a fault of its own.")
                    self._pool._jobs.update(job.id, "failed", problem=told)
            finally:
                self._pool._finish(job.id)
            self._renew_worker()  # a killed one is replaced before the next job asks for it

    def _renew_worker(self) -> None:
        """See that there is a worker, however often it takes: without memory for one just now there is some later."""
        while not self._stopping:
            try:
                self._ensure_worker()
                return
            except Exception as error:
                logger().error("no worker could be started", error=repr(error))
                time.sleep(_REGISTER_PAUSE_S)

    def _serve(self, job: Job) -> None:
        if not self._record(job, "running"):
            return
        asked_in = self._pool._traces.get(job.id)
        traced = span(f"job {job.process}", asked_in, job=job.id, process=job.process)
        with traced, self._pool._metrics.timing(job.process):
            self._work(job)
        ended = self._patiently(lambda: self._pool._jobs.get(job.id))
        self._pool._metrics.count(job.process, ended.status)
        logger().info("job ended", process=job.process, job=job.id, status=ended.status)

    def _record(self, job: Job, status: Status, **values: Any) -> bool:
        """Move a job on in the register. What is not recorded would be waited for, for ever."""
        return self._patiently(lambda: self._pool._jobs.update(job.id, status, **values))

    def _patiently(self, ask: Callable[[], Answer]) -> Answer:
        """What the register answers, once it can be reached again."""
        while True:
            try:
                return ask()
            except UnavailableError:
                if self._stopping:
                    raise
                time.sleep(_REGISTER_PAUSE_S)

    def _abandon_worker(self) -> None:
        """Replace a worker that may still be at its job: what it says must not be taken for the next one's."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
        self._connection = None

    def stop(self) -> None:
        self._stopping = True
        with self._lock:
            if self._process is not None:
                self._process.kill()

    def kill_if_running(self, job_id: str) -> None:
        with self._lock:
            if self._job_id == job_id and self._process is not None:
                self._process.kill()

    def _ensure_worker(self) -> Connection:
        if self._connection is None or self._process is None or not self._process.is_alive():
            self.ready = False
            ours, theirs = _SPAWN.Pipe()
            # No daemon: those may have no children, and a job may fan out over processes.
            process = _SPAWN.Process(target=worker_main, args=(theirs, self._pool._worker), daemon=False)
            process.start()
            theirs.close()
            with self._lock:
                self._process, self._connection = process, ours
                if self._stopping:
                    process.kill()
            self._await_ready(ours)
        return self._connection

    def _await_ready(self, connection: Connection) -> None:
        try:
            self.ready = json.loads(connection.recv_bytes())["event"] == "ready"
        except (EOFError, OSError):
            if not self._stopping:
                logger().error("a worker ended before it was ready")

    def _work(self, job: Job) -> None:
        try:
            connection = self._ensure_worker()
            with self._lock:
                self._job_id = job.id
            if self._patiently(lambda: self._pool._jobs.get(job.id)).ended:  # dismissed between the queue and here
                return
            request = {
                "job": job.id,
                "process": job.process,
                "inputs": job.inputs,
                "correlation_id": job.correlation_id,
            }
            connection.send_bytes(json.dumps(request).encode())
            while not self._handle(job, json.loads(connection.recv_bytes())):
                pass
        except (EOFError, OSError):
            self._lost(job)
        finally:
            with self._lock:
                self._job_id = ""

    def _handle(self, job: Job, message: dict[str, Any]) -> bool:
        """Record what the worker says; whether the job has ended."""
        if message["event"] == "progress":
            with contextlib.suppress(UnavailableError):  # the next report will do
                told = {"progress": message["percent"], "message": message["message"]}
                self._pool._jobs.update(job.id, "running", **told)
            return False
        if message["event"] == "done":
            self._record(job, "successful", progress=100.0, message="", outputs=message["outputs"])
            self._pool._metrics.describe(job.process, message["outputs"], message["facts"])
        else:
            detail = message["problem"].get("detail", "")
            self._record(job, "failed", message=detail, problem=message["problem"])
            logger().warning("job failed", process=job.process, job=job.id, problem=message["problem"])
        return True

    def _lost(self, job: Job) -> None:
        if self._process is not None:
            self._process.join(5)
        self._connection = None
        self._pool._discard(job.id)
        if self._stopping:
            return
        detail = "The worker process that ran this job was killed; nothing of it remains. Submit the job again."
        lost = problem(500, "about:blank", "The worker was lost", detail)
        if self._record(job, "failed", message=detail, problem=lost):
            logger().error("worker lost", process=job.process, job=job.id)
