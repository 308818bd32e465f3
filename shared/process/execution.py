"""From inputs to a committed step: the key, the answer from the manifest, the run, the commit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import InputEntry, Manifest, Product, combine, step_key
from shared.artifacts.reference import ArtifactRef
from shared.artifacts.store import ArtifactStore
from shared.contracts.limits import InputLimits
from shared.errors import SmokeglintError
from shared.process.context import JobContext, Report, finite
from shared.process.declaration import Process, ProcessInputs, parameters, references
from shared.versions import code_version


@dataclass(frozen=True)
class Step:
    """A process with its inputs resolved: what it is called in the store, and what its products will say."""

    process: Process
    inputs: ProcessInputs
    address: StepAddress
    entries: tuple[InputEntry, ...]
    product: Product


def resolve_step(process: Process, inputs: ProcessInputs, store: ArtifactStore, version: str) -> Step:
    """Hash every referenced input and derive the step's key and product attributes from them.

    Raises ForbiddenReferenceError, MissingArtifactError or TamperedArtifactError for a reference that cannot be used.
    """
    entries, products = [], []
    for name, reference in references(inputs):
        location, digest = store.open_reference(reference)
        entries.append(InputEntry(name=name, href=store.roots.relative(location), sha256=digest))
        known = store.product_of(location)
        if known is not None:
            products.append(known)
    hashes = {entry.name: entry.sha256 for entry in entries}
    key = step_key(process.id, version, process.model_version, hashes, parameters(inputs))
    return Step(
        process,
        inputs,
        StepAddress(inputs.case, inputs.cycle, process.id, key),
        tuple(entries),
        combine(process.id, version, process.model_version, products),
    )


def finished_outputs(step: Step, store: ArtifactStore) -> dict[str, Any] | None:
    """The outputs of a step that is already done and verifies, else None."""
    manifest = store.load(step.address)
    return _outputs(step.address, store, manifest) if manifest else None


def run_step(
    step: Step, store: ArtifactStore, owner: str, job_id: str, report: Report, limits: InputLimits | None = None
) -> dict[str, Any]:
    """Run the process in a staging folder and commit what it made; nothing is left if it fails."""
    with store.staging(owner, job_id) as staging:
        context = JobContext(store, staging, step.product, report, limits)
        outputs = step.process.run(step.inputs, context)
        if not isinstance(outputs, step.process.outputs):
            raise SmokeglintError(f"{step.process.id} returned {type(outputs).__name__}, not its declared outputs")
        manifest = Manifest(
            case=step.address.case,
            cycle=step.address.cycle,
            key=step.address.key,
            product=context.product,
            inputs=step.entries,
            parameters=parameters(step.inputs),
            outputs=finite(outputs.model_dump(mode="json")),
            files=context.entries(),
        )
        manifest = store.commit(step.address, context.outputs, manifest)
    return _outputs(step.address, store, manifest)


def facts(step: Step, store: ArtifactStore) -> dict[str, Any]:
    """What the metrics tell of a finished step: bytes written, time of its oldest input, share simulated."""
    manifest = store.record(step.address)
    if manifest is None:
        return {}
    written = sum(entry.size for entry in manifest.files.values())
    product = manifest.product
    return {"bytes": written, "oldest_input": product.oldest_input, "simulated_share": product.simulated_share}


def _outputs(address: StepAddress, store: ArtifactStore, manifest: Manifest) -> dict[str, Any]:
    return {name: _absolute(value, address, store, manifest) for name, value in manifest.outputs.items()}


def _absolute(value: Any, address: StepAddress, store: ArtifactStore, manifest: Manifest) -> Any:
    """Outputs with the bare file names of their references replaced by full URLs."""
    if isinstance(value, list):
        return [_absolute(item, address, store, manifest) for item in value]
    if not isinstance(value, dict):
        return value
    if set(value) == set(ArtifactRef.model_fields) and value["href"] in manifest.files:
        return store.reference(address, value["href"], manifest.files[value["href"]]).model_dump()
    return {name: _absolute(item, address, store, manifest) for name, item in value.items()}


def service_code_version(module: str) -> str:
    """The code version of a service: its own package and ``shared``. ``module`` is ``services.<name>.processes``."""
    root = Path(__file__).resolve().parents[2]
    package = module.split(".")[:-1]
    return code_version(*([root.joinpath(*package)] if package else []), root / "shared")


def validate_inputs(process: Process, values: Any) -> ProcessInputs:
    """The inputs as the process declares them; pydantic's ValidationError names the field otherwise."""
    checked: BaseModel = process.inputs.model_validate(values)
    assert isinstance(checked, ProcessInputs)
    return checked
