"""What a running process sees: its inputs as checked tables and files, its staging folder, its progress report."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shared.artifacts.manifest import FileEntry, Product, combine
from shared.artifacts.reference import ArtifactRef
from shared.artifacts.store import ArtifactStore, describe_file
from shared.contracts.limits import InputLimits
from shared.errors import ContractError, SmokeglintError

if TYPE_CHECKING:
    import pandas as pd

    from shared.contracts.schema import TableWriter

Report = Callable[[float, str], None]


class JobContext:
    """Reads inputs and stages outputs of one job. Nothing it writes is seen before the job is committed."""

    def __init__(
        self, store: ArtifactStore, staging: Path, product: Product, report: Report, limits: InputLimits | None = None
    ) -> None:
        self._store = store
        self._staging = staging
        self._product = product
        self._report = report
        self._limits = limits or InputLimits()
        self._outputs: dict[str, Path] = {}
        self._own: dict[str, dict[str, Any]] = {}

    # Inputs

    def path(self, reference: ArtifactRef) -> Path:
        """A verified local path of an input; fetched into the staging folder if it lies on another store.

        ContractError if the file is larger than the limits set.
        """
        path = self._store.fetch(reference, self._staging / "inputs")
        self._limits.check(path, reference.name)
        return path

    def read_table(self, reference: ArtifactRef, contract: str) -> pd.DataFrame:
        """A table checked against the contract of that name (a GeoDataFrame where it has a geometry)."""
        from shared.contracts import schema, tables  # pandas stays in the worker

        return schema.read_table(self.path(reference), tables.ALL[contract])

    def read_json(self, reference: ArtifactRef) -> Any:
        """A JSON document; ContractError if it is none."""
        try:
            return json.loads(self.path(reference).read_bytes())
        except ValueError as error:
            raise ContractError(f"'{reference.name}' is not JSON: {error}", field=reference.name) from error

    # Outputs

    def product_attributes(self, sources: Sequence[ArtifactRef] | None = None) -> dict[str, Any]:
        """What every product must carry; the writers below put it into tables and JSON documents by themselves.

        ``sources`` names the inputs that a file was made from, where that is not all of them.
        """
        return (self._product if sources is None else self._product_from(sources)).attributes()

    def _product_from(self, sources: Sequence[ArtifactRef]) -> Product:
        located = [self._store.open_reference(reference)[0] for reference in sources]
        known = [product for product in map(self._store.product_of, located) if product is not None]
        return combine(self._product.process, self._product.code_version, self._product.model_version, known)

    def mark_simulated(self, share: float = 1.0) -> None:
        """State that this process itself simulates; before the first output, so that every file says so."""
        if self._outputs:
            raise SmokeglintError("mark_simulated must come before the first output is written")
        share = max(share, self._product.simulated_share)
        self._product = self._product.model_copy(update={"simulated": True, "simulated_share": round(share, 4)})

    def new_file(self, name: str, sources: Sequence[ArtifactRef] | None = None) -> Path:
        """A path to write an output to; ``ref`` then gives its reference. ``sources``: see ``product_attributes``."""
        path = self._staging / name
        self._outputs[name] = path
        if sources is not None:
            attributes = self.product_attributes(sources)
            self.describe(name, **{key: attributes[key] for key in ("simulated", "simulated_share", "oldest_input")})
        return path

    def describe(self, name: str, **own: Any) -> None:
        """State ``simulated``, ``simulated_share``, ``oldest_input`` or ``source`` of one file where it differs."""
        self._own[name] = own

    def ref(self, name: str) -> ArtifactRef:
        """The reference to an output by its bare name; made absolute when the job is committed."""
        entry = describe_file(self._outputs[name])
        return ArtifactRef(href=name, type=entry.type, sha256=entry.sha256)

    def write_table(
        self, name: str, frame: pd.DataFrame, contract: str, sources: Sequence[ArtifactRef] | None = None
    ) -> ArtifactRef:
        """Check a table against its contract and stage it as Parquet with the product attributes (of ``sources``)."""
        from shared.contracts import schema, tables  # pandas stays in the worker

        path = self.new_file(name, sources)
        schema.write_table(path, frame, tables.ALL[contract], self.product_attributes(sources))
        return self.ref(name)

    def table_writer(
        self, name: str, empty: pd.DataFrame, contract: str, sources: Sequence[ArtifactRef] | None = None
    ) -> TableWriter:
        """As ``write_table``, part by part, for tables that should not be held at once; ``ref`` once it is closed."""
        from shared.contracts import schema, tables  # pandas stays in the worker

        path = self.new_file(name, sources)
        return schema.TableWriter(path, tables.ALL[contract], empty, self.product_attributes(sources))

    def write_json(self, name: str, document: dict[str, Any]) -> ArtifactRef:
        """Stage a JSON report with the product attributes under ``product``; NaN and infinity become null."""
        content = {**finite(document), "product": self.product_attributes()}
        text = json.dumps(content, sort_keys=True, indent=1, allow_nan=False, default=str)
        self.new_file(name).write_text(text + "\n", encoding="utf-8")
        return self.ref(name)

    def progress(self, percent: float, message: str = "") -> None:
        """Report progress, 0 to 100 per cent."""
        self._report(min(max(float(percent), 0.0), 100.0), message)

    @property
    def product(self) -> Product:
        """The product attributes as they stand."""
        return self._product

    @property
    def outputs(self) -> dict[str, Path]:
        """The staged outputs by name."""
        return dict(self._outputs)

    def entries(self) -> dict[str, FileEntry]:
        """The manifest entries of the staged outputs."""
        return {name: describe_file(path, **self._own.get(name, {})) for name, path in sorted(self._outputs.items())}


def finite(value: Any) -> Any:
    """A value as strict JSON can hold it: numpy scalars as numbers, NaN and infinity as None."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()  # numpy scalars
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
