"""A service small enough to test the process API with: a table in, a table out, and ways to fail."""

from __future__ import annotations

import contextlib
import os
import resource
import time
from collections.abc import Iterator

from pydantic import Field

from shared.errors import DomainError
from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs


class ScaleInputs(ProcessInputs):
    targets: ArtifactRef = Field(description="targets table")
    factor: float = Field(1.0, gt=0, le=10, description="what priorities are multiplied with")


class ScaleOutputs(ProcessOutputs):
    targets: ArtifactRef
    count: int


def scale(inputs: ScaleInputs, context: JobContext) -> ScaleOutputs:
    frame = context.read_table(inputs.targets, "TARGETS")
    context.progress(50, "scaling")
    if len(frame) == 0:
        raise DomainError("The targets table is empty.", field="targets", value=0, accepted="at least one row")
    scaled = frame.assign(priority=frame["priority"] * inputs.factor)
    return ScaleOutputs(targets=context.write_table("targets.parquet", scaled, "TARGETS"), count=len(frame))


class SleepInputs(ProcessInputs):
    seconds: float = Field(ge=0, le=60, description="how long to sleep")
    outcome: str = Field("well", pattern="^(well|crash|fault|full-disk|full-at-manifest)$", description="how to end")


class SleepOutputs(ProcessOutputs):
    report: ArtifactRef
    slept_s: float


def sleep(inputs: SleepInputs, context: JobContext) -> SleepOutputs:
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))  # there is room again
    context.new_file("half.txt").write_text("half")
    context.progress(10, "sleeping")
    time.sleep(inputs.seconds)
    if inputs.outcome == "crash":
        os._exit(9)
    if inputs.outcome == "fault":
        raise RuntimeError("a secret that must not reach the client")
    with contextlib.ExitStack() as disk:
        if inputs.outcome == "full-disk":
            disk.enter_context(limit_file_size(10))
        report = context.write_json("report.json", {"slept": float("nan")})
    if inputs.outcome == "full-at-manifest":
        room = context.outputs["report.json"].stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))  # holds when the job is committed
    return SleepOutputs(report=report, slept_s=inputs.seconds)


@contextlib.contextmanager
def limit_file_size(room_bytes: int) -> Iterator[None]:
    """No file of this process may grow beyond: the system refuses the write (EFBIG), as it does on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


PROCESSES = [
    Process("scale-targets", "Scale targets", "Multiplies priorities.", ScaleInputs, ScaleOutputs, scale),
    Process("sleep", "Sleep", "Sleeps, then ends as told.", SleepInputs, SleepOutputs, sleep),
]
