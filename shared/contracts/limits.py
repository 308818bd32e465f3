"""How large an input may be: what a file says of itself is checked before it is unpacked into memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from shared.errors import ContractError


@dataclass(frozen=True)
class InputLimits:
    """Most rows of a table, and most bytes of a grid once unpacked."""

    table_rows: int = 50_000_000
    grid_bytes: int = 8_000_000_000

    def check(self, path: Path, name: str) -> None:
        """Nothing, or ContractError if the file named ``name`` declares more; a file that cannot be read passes.

        Its reader will then say what is wrong with it.
        """
        if path.suffix in (".parquet", ".geoparquet"):
            _compare(name, _rows(path), self.table_rows, "rows")
        elif path.suffix in (".nc", ".nc4"):
            _compare(name, _unpacked_bytes(path), self.grid_bytes, "bytes once unpacked")


def _compare(name: str, found: int, limit: int, unit: str) -> None:
    if found > limit:
        raise ContractError(
            f"'{name}' holds {found} {unit}; at most {limit} are read here.",
            field=name,
            value=found,
            accepted=f"≤ {limit}",
        )


def _rows(path: Path) -> int:
    from pyarrow import ArrowException, parquet

    try:
        return int(parquet.read_metadata(path).num_rows)
    except (ArrowException, OSError):
        return 0


def _unpacked_bytes(path: Path) -> int:
    import math

    import netCDF4

    def size(group: netCDF4.Dataset | netCDF4.Group) -> int:
        own = [math.prod(v.shape) * getattr(v.dtype, "itemsize", 8) for v in group.variables.values()]
        return sum(own) + sum(size(child) for child in group.groups.values())

    try:
        with netCDF4.Dataset(str(path)) as dataset:
            return size(dataset)
    except (OSError, RuntimeError, ValueError):
        return 0
