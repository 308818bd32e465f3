"""OGC API – Processes, Part 1: declare a process, and the rest comes from here."""

from shared.artifacts.reference import ArtifactRef
from shared.process.context import JobContext
from shared.process.declaration import Process, ProcessInputs, ProcessOutputs

__all__ = ["ArtifactRef", "JobContext", "Process", "ProcessInputs", "ProcessOutputs"]
