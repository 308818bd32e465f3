"""A service behind its HTTP face: processes, jobs, workers and store, put together from settings."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import anyio
from pydantic import BaseModel, ConfigDict, Field

from shared.artifacts.roots import is_local
from shared.artifacts.store import ArtifactStore
from shared.errors import DomainError, JobFailedError, NotFoundError, SmokeglintError
from shared.process import execution
from shared.process.declaration import Process, body_hash
from shared.process.jobs import Job, JobRegister, JobRequest
from shared.process.metrics import ServiceMetrics
from shared.process.pool import WorkerPool
from shared.process.problem import problem
from shared.settings import ServiceSettings
from shared.telemetry import logger

_WAITING = 100  # synchronous requests that wait at once; further ones wait for a place


class ExecuteRequest(BaseModel):
    """The body of an execution request."""

    model_config = ConfigDict(extra="forbid")
    inputs: dict[str, Any] = Field(default_factory=dict)
    outputs: dict[str, Any] | None = Field(None, description="outputs wanted; all if left out")
    response: str = Field("document", pattern="^document$", description="'document' is the one form offered")


@dataclass(frozen=True)
class Answer:
    """A job and the outputs that its request asked for."""

    job: Job
    wanted: tuple[str, ...] | None


class Service:
    """Accepts requests, answers from the manifest where it can, and queues the rest."""

    def __init__(self, name: str, processes: list[Process], module: str, settings: ServiceSettings) -> None:
        self.name = name
        self.settings = settings
        self.processes = {process.id: process for process in processes}
        self._module = module
        self._version = execution.service_code_version(module)
        self.metrics = ServiceMetrics(name)
        self.store = ArtifactStore(settings.roots)
        self.jobs = JobRegister(settings.database_url(name), settings.wait_s, schema=name)
        self.answers_at_once = self.jobs.readers_never_wait and is_local(settings.artifact_root)
        self.pool = WorkerPool(
            name, module, settings, self.jobs, self.metrics, lambda job_id: self.store.discard(name, job_id)
        )
        self.waiting = anyio.CapacityLimiter(_WAITING)
        self.metrics.watch_queue(lambda: self.pool.queued)

    def start(self) -> None:
        """Clear what a killed predecessor left, fail its running jobs, requeue its waiting ones, start the workers."""
        self._await_store()
        swept = self.store.sweep(self.name, self.processes)
        detail = "The service was restarted while this job ran; submit it again."
        waiting = self.jobs.recover(problem(500, "about:blank", "The service was restarted", detail))
        logger().info("service starts", code_version=self._version, swept=swept, requeued=len(waiting))
        for job in waiting:
            self.pool.submit(job)
        self.pool.start()

    def _await_store(self) -> None:
        """Wait for a store that comes up after its service; SmokeglintError if it does not."""
        deadline, pause_s = time.monotonic() + self.settings.wait_s, 0.5
        while not self.store.writable():
            root = self.settings.artifact_root
            if time.monotonic() > deadline:
                raise SmokeglintError(f"Nothing can be written under {root}; waited {self.settings.wait_s:.0f} s.")
            logger().warning("waiting for the artifact store", root=root, again_in_s=pause_s)
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, 10.0)

    def stop(self) -> None:
        """End the workers and release the database."""
        self.pool.stop()
        self.jobs.close()

    def checks(self) -> dict[str, bool]:
        """What the service cannot work without, and whether it is there."""
        return {"worker": self.pool.ready, "store": self.store.writable(), "jobs": self.jobs.answers()}

    def process(self, process_id: str) -> Process:
        """The process of that id; NotFoundError names those there are."""
        if process_id not in self.processes:
            known = ", ".join(sorted(self.processes))
            raise NotFoundError("process", process_id, f"There is no process '{process_id}' here; there are: {known}.")
        return self.processes[process_id]

    def execute(self, process_id: str, body: bytes, key: str | None, correlation: str, owner: str = "") -> Answer:
        """Accept a request: validate, look for a finished step, else queue a job."""
        process = self.process(process_id)
        request = ExecuteRequest.model_validate_json(body)
        wanted = self._wanted(process, request)
        inputs = execution.validate_inputs(process, request.inputs)
        step = execution.resolve_step(process, inputs, self.store, self._version)
        done = execution.finished_outputs(step, self.store)
        values = inputs.model_dump(mode="json")
        asked = JobRequest(process_id, values, body_hash(process_id, body), key, correlation, owner)
        limit = 0 if done else self.settings.max_jobs_per_key
        job, is_new = self.jobs.submit(asked, limit)
        if not is_new and job.status == "successful" and not (done or execution.finished_outputs(step, self.store)):
            self.jobs.free_key(job.id)  # the register remembers a success, but the store, which decides, has lost it
            job, is_new = self.jobs.submit(asked, limit)
        if done is not None:
            self.jobs.update(job.id, "successful", progress=100.0, message="answered from the store", outputs=done)
        elif job.status == "accepted" and self.pool.submit(job):
            # Not only a new one: the answer to the first asking may have been lost after the register had taken it.
            logger().info("job accepted", process=process_id, job=job.id, key=step.address.key)
        return Answer(self.jobs.get(job.id), wanted)

    def _wanted(self, process: Process, request: ExecuteRequest) -> tuple[str, ...] | None:
        if not request.outputs:
            return None
        known = process.outputs.model_fields
        for name in request.outputs:
            if name not in known:
                raise DomainError(
                    f"{process.id} has no output '{name}'.", field="outputs", value=name, accepted=", ".join(known)
                )
        return tuple(request.outputs)

    def wait(self, answer: Answer) -> dict[str, Any]:
        """The outputs of a job once it has ended; JobFailedError with its problem otherwise."""
        results = self.results(self.pool.wait(answer.job.id))
        return results if answer.wanted is None else {name: results[name] for name in answer.wanted}

    def results(self, job: Job) -> dict[str, Any]:
        """The outputs of a job; NotFoundError while there are none, JobFailedError if there never will be."""
        if job.status == "successful" and job.outputs is not None:
            return job.outputs
        if job.status == "failed":
            raise JobFailedError(job.message, job.problem)
        if job.status == "dismissed":
            detail = f"Job {job.id} was dismissed and has no result."
            raise JobFailedError(detail, problem(410, "about:blank", "The job was dismissed", detail))
        raise NotFoundError("result", job.id, f"Job {job.id} is {job.status}; ask again later.")
