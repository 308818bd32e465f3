"""Bring a case bundle into the artifact store, so that every product's lineage ends at its inputs."""

from __future__ import annotations

import shutil
from pathlib import Path

from pydantic import Field

from flows.cases.bundle import CASE_FILE, Case, read_case
from shared.process import ArtifactRef, JobContext, Process, ProcessInputs, ProcessOutputs


class ImportCaseInputs(ProcessInputs):
    case_file: ArtifactRef = Field(description="case.toml, in the folder that it describes")
    files: list[ArtifactRef] = Field(description="the files that it names, so that a changed one is imported anew")


class ImportCaseOutputs(ProcessOutputs):
    case_file: ArtifactRef
    inputs: dict[str, ArtifactRef]
    nature: dict[str, ArtifactRef]


def import_case(inputs: ImportCaseInputs, context: JobContext) -> ImportCaseOutputs:
    """Copy each file under its logical name, with its own provenance in the manifest."""
    case = read_case(context.path(inputs.case_file).parent)
    shutil.copyfile(case.folder / CASE_FILE, context.new_file(CASE_FILE))
    return ImportCaseOutputs(
        case_file=context.ref(CASE_FILE),
        inputs={name: _copy(case, name, path, context) for name, path in sorted(case.inputs.items())},
        nature={name: _copy(case, name, path, context) for name, path in sorted(case.nature.items())},
    )


def _copy(case: Case, logical: str, path: Path, context: JobContext) -> ArtifactRef:
    origin = case.provenance[logical]
    name = logical + path.suffix
    shutil.copyfile(path, context.new_file(name))
    oldest = origin.oldest.strftime("%Y-%m-%dT%H:%M:%SZ")
    context.describe(
        name,
        simulated=origin.simulated,
        simulated_share=float(origin.simulated),
        oldest_input=oldest,
        source=origin.source,
    )
    return context.ref(name)


IMPORT_CASE = Process(
    "import-case",
    "Import a case bundle",
    "Copies a bundle into the store.",
    ImportCaseInputs,
    ImportCaseOutputs,
    import_case,
)
