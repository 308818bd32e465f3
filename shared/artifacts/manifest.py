"""What a finished step says of itself. A step is done if and only if its manifest verifies."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict

MANIFEST = "manifest.json"


class Product(BaseModel):
    """What every product carries: simulated or not and to what share, its oldest input, and what made it."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    process: str
    code_version: str
    model_version: str = ""
    simulated: bool = False
    simulated_share: float = 0.0
    oldest_input: str = ""

    def attributes(self) -> dict[str, Any]:
        """The same as a plain mapping, for file metadata."""
        return self.model_dump()


class FileEntry(BaseModel):
    """One file of a step. ``simulated`` and the two after it are given where they differ from the whole step's."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    sha256: str
    size: int
    type: str
    simulated: bool | None = None
    simulated_share: float | None = None
    oldest_input: str | None = None
    source: str | None = None


class InputEntry(BaseModel):
    """One input of a step: ``href`` is relative to the artifact root, so that lineage is a walk along links."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str
    href: str
    sha256: str


class Manifest(BaseModel):
    """The record of a finished step, put in place last."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    case: str
    cycle: str
    key: str
    product: Product
    inputs: tuple[InputEntry, ...]
    parameters: dict[str, Any]
    outputs: dict[str, Any]
    files: dict[str, FileEntry]

    def to_bytes(self) -> bytes:
        """Canonical JSON: sorted keys, no clock, no absolute path."""
        return (json.dumps(self.model_dump(exclude_none=True), sort_keys=True, indent=1) + "\n").encode()

    def product_of(self, name: str) -> Product:
        """The product attributes of one file of the step."""
        entry = self.files[name]
        own = {key: getattr(entry, key) for key in ("simulated", "simulated_share", "oldest_input")}
        return self.product.model_copy(update={key: value for key, value in own.items() if value is not None})


def combine(process: str, code_version: str, model_version: str, inputs: Iterable[Product]) -> Product:
    """What follows from the inputs: the simulated share is the mean of theirs, the age that of the oldest."""
    known = list(inputs)
    shares = [product.simulated_share for product in known]
    return Product(
        process=process,
        code_version=code_version,
        model_version=model_version,
        simulated=any(product.simulated for product in known),
        simulated_share=round(sum(shares) / len(shares), 4) if shares else 0.0,
        oldest_input=min((product.oldest_input for product in known if product.oldest_input), default=""),
    )


def step_key(process: str, code_version: str, model_version: str, inputs: Mapping[str, Any], parameters: Any) -> str:
    """The key of a step: a hash of the process, code and model version, input hashes and parameters."""
    identity = [process, code_version, model_version, inputs, parameters]
    canonical = json.dumps(identity, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()[:24]
