"""One declaration a process: an id, a title, an input model, an output model and a function."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field

from shared.artifacts.reference import ArtifactRef

if TYPE_CHECKING:
    from shared.process.context import JobContext

ADDRESS_FIELDS = ("case", "cycle")


class ProcessInputs(BaseModel):
    """Base of every input model: where the results belong. Neither field enters the step's key."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    case: str = Field("adhoc", pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,119}$", description="case the results belong to")
    cycle: str = Field("adhoc", pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,119}$", description="cycle within the case")


class ProcessOutputs(BaseModel):
    """Base of every output model; files are ArtifactRef, small values stand inline."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class Process:
    """A process as a service offers it. ``model_version`` names the shipped model that its results depend on."""

    id: str
    title: str
    description: str
    inputs: type[ProcessInputs]
    outputs: type[ProcessOutputs]
    run: Callable[[Any, JobContext], ProcessOutputs]
    model_version: str = ""


def references(inputs: BaseModel) -> Iterator[tuple[str, ArtifactRef]]:
    """Every reference among the inputs, with its field name; those of a list as ``field[0]``, ``field[1]``, …"""
    for name in type(inputs).model_fields:
        value = getattr(inputs, name)
        if isinstance(value, ArtifactRef):
            yield name, value
        elif isinstance(value, list | tuple):
            for index, item in enumerate(value):
                if isinstance(item, ArtifactRef):
                    yield f"{name}[{index}]", item


def parameters(inputs: BaseModel) -> dict[str, Any]:
    """The inputs that are not references and do not only say where the results belong, as JSON values."""
    by_reference = {name.split("[")[0] for name, _ in references(inputs)}
    left_out = by_reference | set(ADDRESS_FIELDS)
    return {name: value for name, value in inputs.model_dump(mode="json").items() if name not in left_out}


def body_hash(process: str, body: bytes) -> str:
    """The identity of a request, for idempotency keys."""
    return hashlib.sha256(process.encode() + b"\0" + body).hexdigest()
