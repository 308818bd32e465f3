"""One schema a table, checked on write and on read.

Tables are Parquet files; those with a geometry are GeoParquet in EPSG:4326. Times are ``timestamp[ms, UTC]``: readers
coerce whatever resolution and zone a file holds, writers follow the contract.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Number
from pathlib import Path
from typing import Any, Literal

import geopandas
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import shapely

from shared.errors import ContractError

Kind = Literal["int64", "int32", "float64", "string", "bool", "time", "geometry"]

PRODUCT_KEY = b"smokeglint"
_TEXTS = ("string", "empty")


@dataclass(frozen=True)
class Column:
    """A column: its kind, whether nulls may stand in it, whether it may be absent, and what values it takes.

    ``minimum`` and ``maximum`` bound numbers (inclusive); ``values`` lists the accepted texts.
    """

    name: str
    kind: Kind
    nullable: bool = False
    required: bool = True
    minimum: float | None = None
    maximum: float | None = None
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class TableSchema:
    """A table contract: a name, its columns and the columns whose values must be unique together."""

    name: str
    columns: tuple[Column, ...]
    unique: tuple[str, ...] = field(default=())

    @property
    def has_geometry(self) -> bool:
        return any(column.kind == "geometry" for column in self.columns)

    def check(self, frame: pd.DataFrame) -> pd.DataFrame:
        """The frame with contract types, the contract's columns first; else ContractError naming column and row."""
        missing = [c.name for c in self.columns if c.required and c.name not in frame.columns]
        if missing:
            raise ContractError(
                f"Table '{self.name}' lacks the column(s) {', '.join(missing)}; "
                f"it has {', '.join(map(str, frame.columns))}.",
                field=missing[0],
                accepted=", ".join(c.name for c in self.columns if c.required),
            )
        present = [c for c in self.columns if c.name in frame.columns]
        for column in present:
            if list(frame.columns).count(column.name) > 1:
                raise self._fault(column, None, None, "stands there twice")
        coerced = {column.name: self._coerce(column, frame[column.name]) for column in present}
        # Index and all: a frame that was filtered or sorted must not pair its further columns with other rows.
        extra = {str(name): frame[name].reset_index(drop=True) for name in frame.columns if name not in coerced}
        checked = pd.DataFrame({**coerced, **extra}).reset_index(drop=True)
        self._check_unique(checked)
        if self.has_geometry:
            name = next(c.name for c in present if c.kind == "geometry")
            located: pd.DataFrame = geopandas.GeoDataFrame(checked, geometry=name, crs="EPSG:4326")
            return located
        return checked

    def _coerce(self, column: Column, values: pd.Series[Any]) -> pd.Series[Any]:
        try:
            coerced: pd.Series[Any] = _COERCERS[column.kind](values.reset_index(drop=True))
        except (TypeError, ValueError, OverflowError) as error:
            what = f"holds {values.dtype}, not {column.kind} ({error})"
            raise self._fault(column, None, values.dtype, what) from error
        null = coerced.isna()
        if null.any() and not column.nullable:
            row = int(np.flatnonzero(null)[0])
            raise self._fault(column, row, "null", f"is null in row {row}")
        self._check_range(column, coerced)
        return coerced

    def _check_range(self, column: Column, values: pd.Series[Any]) -> None:
        if column.kind == "geometry":
            _check_positions(self, column, values)
            return
        bad = pd.Series(False, index=values.index)
        if column.minimum is not None:
            bad |= values < column.minimum
        if column.maximum is not None:
            bad |= values > column.maximum
        if column.kind == "float64":
            bad |= np.isinf(values)
        if column.values:
            bad |= values.notna() & ~values.isin(column.values)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise self._fault(column, row, values[row], f"is {values[row]!r} in row {row}")

    def _check_unique(self, frame: pd.DataFrame) -> None:
        if not self.unique:
            return
        twice = frame.duplicated(list(self.unique))
        if twice.any():
            row = int(np.flatnonzero(twice)[0])
            value = dict(frame.loc[row, list(self.unique)])
            raise ContractError(
                f"Table '{self.name}' holds {value} twice; the second is row {row}.",
                field=self.unique[0],
                value=value,
                accepted="one row for each " + ", ".join(self.unique),
            )

    def _fault(self, column: Column, row: int | None, value: Any, what: str) -> ContractError:
        accepted = _accepted(column)
        return ContractError(
            f"Table '{self.name}', column '{column.name}' {what}; accepted: {accepted}.",
            field=column.name,
            value=value,
            accepted=accepted,
        )


def _accepted(column: Column) -> str:
    if column.values:
        return " | ".join(column.values)
    if column.kind == "geometry":
        return "finite longitude -180..180 and latitude -90..90, EPSG:4326"
    bounds = ""
    if column.minimum is not None or column.maximum is not None:
        low = "-inf" if column.minimum is None else column.minimum
        high = "inf" if column.maximum is None else column.maximum
        bounds = f" in {low}..{high}"
    return f"{column.kind}{bounds}{' or null' if column.nullable else ''}"


def _check_positions(schema: TableSchema, column: Column, values: pd.Series[Any]) -> None:
    shapes = values.to_numpy()
    bounds = shapely.bounds(shapes)
    inside = (bounds[:, 0] >= -180) & (bounds[:, 2] <= 180) & (bounds[:, 1] >= -90) & (bounds[:, 3] <= 90)
    # Empty shapes have NaN bounds and so are not inside; bounds pass over a NaN vertex among others, so ask for each.
    vertices, owner = shapely.get_coordinates(shapes, return_index=True)
    inside[owner[~np.isfinite(vertices).all(axis=1)]] = False
    bad = ~inside & ~shapely.is_missing(shapes)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise schema._fault(column, row, values.iloc[row], f"is {values.iloc[row]} in row {row}")


def _as_integer(values: pd.Series[Any], dtype: str) -> pd.Series[Any]:
    numbers = pd.to_numeric(values)
    known = numbers.notna()
    if not np.all(np.asarray(numbers[known], dtype=np.float64) % 1 == 0):
        raise ValueError("not whole numbers")
    limits = np.iinfo(dtype)  # astype would wrap around without a word
    if known.any() and not limits.min <= int(numbers[known].min()) <= int(numbers[known].max()) <= limits.max:
        raise ValueError(f"numbers beyond {limits.min}..{limits.max}")
    chosen: Any = dtype if known.all() else dtype.capitalize()  # pandas' nullable integers
    whole: pd.Series[Any] = numbers.astype(chosen)
    return whole


def _as_float(values: pd.Series[Any]) -> pd.Series[Any]:
    numbers: Any = pd.to_numeric(values)
    floats: pd.Series[Any] = numbers.astype("float64")
    return floats


def _as_text(values: pd.Series[Any]) -> pd.Series[Any]:
    categorical = isinstance(values.dtype, pd.CategoricalDtype)  # then each text is looked at once
    text = values.astype("object")
    if pd.api.types.infer_dtype(values.cat.categories if categorical else text, skipna=True) not in _TEXTS:
        raise ValueError("not texts")
    known = values.notna()
    return text if known.all() else text.where(known, None)


def _as_bool(values: pd.Series[Any]) -> pd.Series[Any]:
    known = values.notna()
    if not values[known].isin([0, 1, True, False]).all():
        raise ValueError("not true or false")
    chosen: Any = bool if known.all() else "boolean"  # pandas' nullable truth values
    return values.astype(chosen)


def _as_time(values: pd.Series[Any]) -> pd.Series[Any]:
    hidden = values.dtype == object and values.map(lambda value: isinstance(value, Number)).any()
    if hidden or pd.api.types.is_numeric_dtype(values):
        raise ValueError("numbers are not times: give timestamps in UTC")
    return pd.to_datetime(values, utc=True).astype("datetime64[ms, UTC]")


def _as_geometry(values: pd.Series[Any]) -> pd.Series[Any]:
    shapes = geopandas.GeoSeries(values)
    located: pd.Series[Any] = shapes.set_crs("EPSG:4326") if shapes.crs is None else shapes.to_crs("EPSG:4326")
    return located


_COERCERS: Mapping[str, Any] = {
    "int64": lambda values: _as_integer(values, "int64"),
    "int32": lambda values: _as_integer(values, "int32"),
    "float64": _as_float,
    "string": _as_text,
    "bool": _as_bool,
    "time": _as_time,
    "geometry": _as_geometry,
}


def write_table(
    path: str | Path, frame: pd.DataFrame, schema: TableSchema, attributes: Mapping[str, Any] | None = None
) -> None:
    """Write a checked frame as Parquet (GeoParquet if it has a geometry), product attributes in the file's metadata."""
    table = _to_arrow(schema.check(frame))
    metadata = dict(table.schema.metadata or {})
    metadata[PRODUCT_KEY] = json.dumps({"table": schema.name, **(attributes or {})}, sort_keys=True).encode()
    pq.write_table(table.replace_schema_metadata(metadata), str(path), compression="zstd")


class TableWriter:
    """One Parquet file from parts that come one after the other, each checked against the contract and then let go.

    A context manager. Parts have the same columns; what must be unique is so within each part, and the caller sees to
    it between them. Without any part the file holds the columns of ``empty`` and no row.
    """

    def __init__(
        self, path: str | Path, schema: TableSchema, empty: pd.DataFrame, attributes: Mapping[str, Any] | None = None
    ) -> None:
        self._schema = schema
        layout = _to_arrow(schema.check(empty)).schema
        texts = {column.name for column in schema.columns if column.kind == "string"}  # without rows of no type yet
        fields = [pa.field(field.name, pa.string()) if field.name in texts else field for field in layout]
        metadata = dict(layout.metadata or {})
        metadata[PRODUCT_KEY] = json.dumps({"table": schema.name, **(attributes or {})}, sort_keys=True).encode()
        self._layout = pa.schema(fields, metadata)
        self._file = pq.ParquetWriter(str(path), self._layout, compression="zstd")
        self.rows = 0

    def write(self, frame: pd.DataFrame) -> None:
        """Append a part: a row group of its own."""
        if len(frame):
            self._file.write_table(_to_arrow(self._schema.check(frame)).cast(self._layout))
            self.rows += len(frame)

    def __enter__(self) -> TableWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _to_arrow(frame: pd.DataFrame) -> pa.Table:
    if isinstance(frame, geopandas.GeoDataFrame):
        return pa.table(frame.to_arrow(index=False, geometry_encoding="WKB")).replace_schema_metadata(
            {b"geo": json.dumps(_geo_metadata(frame), sort_keys=True).encode()}
        )
    return pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata({})


def _geo_metadata(frame: geopandas.GeoDataFrame) -> dict[str, Any]:
    """GeoParquet 1.1 metadata; without a crs entry the specification means OGC:CRS84, which is ours."""
    name = frame.geometry.name
    kinds = sorted(set(frame.geom_type.dropna().unique()))
    return {"version": "1.1.0", "primary_column": name, "columns": {name: {"encoding": "WKB", "geometry_types": kinds}}}


def read_table(path: str | Path, schema: TableSchema) -> pd.DataFrame:
    """Read and check a table: a GeoDataFrame in EPSG:4326 where the contract has a geometry, else a DataFrame."""
    try:
        table = pq.read_table(str(path))
    except (pa.ArrowInvalid, OSError) as error:
        raise ContractError(f"Table '{schema.name}' cannot be read as Parquet: {error}", field=schema.name) from error
    if not schema.has_geometry:
        return schema.check(table.to_pandas())
    name = next(c.name for c in schema.columns if c.kind == "geometry")
    if name not in table.column_names:
        return schema.check(table.to_pandas())
    geo = json.loads((table.schema.metadata or {}).get(b"geo", b"{}"))
    crs = geo.get("columns", {}).get(name, {}).get("crs")
    frame = table.to_pandas()
    try:
        frame[name] = geopandas.GeoSeries.from_wkb(frame[name], crs=crs or "EPSG:4326").to_crs("EPSG:4326")
    except (TypeError, ValueError, shapely.GEOSException) as error:
        message = f"Table '{schema.name}', column '{name}' does not hold WKB geometry: {error}"
        raise ContractError(message, field=name, accepted="GeoParquet with WKB encoding") from error
    return schema.check(frame)


def read_attributes(path: str | Path) -> dict[str, Any]:
    """The product attributes that a table file carries; empty where it carries none."""
    metadata = pq.read_schema(str(path)).metadata or {}
    attributes: dict[str, Any] = json.loads(metadata.get(PRODUCT_KEY, b"{}"))
    return attributes
