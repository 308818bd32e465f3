"""A service small enough to test the process API with: a table in, a table out, and ways to fail."""

from __future__ import annotations

import os
import time

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
    outcome: str = Field("well", pattern="^(well|crash|fault)$", description="how to end")


class SleepOutputs(ProcessOutputs):
    report: ArtifactRef
    slept_s: float


def sleep(inputs: SleepInputs, context: JobContext) -> SleepOutputs:
    context.new_file("half.txt").write_text("half")
    context.progress(10, "sleeping")
    time.sleep(inputs.seconds)
    if inputs.outcome == "crash":
        os._exit(9)
    if inputs.outcome == "fault":
        raise RuntimeError("a secret that must not reach the client")
    return SleepOutputs(report=context.write_json("report.json", {"slept": float("nan")}), slept_s=inputs.seconds)


PROCESSES = [
    Process("scale-targets", "Scale targets", "Multiplies priorities.", ScaleInputs, ScaleOutputs, scale),
    Process("sleep", "Sleep", "Sleeps, then ends as told.", SleepInputs, SleepOutputs, sleep),
]
