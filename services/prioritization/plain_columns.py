"""Columns of tables that follow no contract of ours (a caller's CSV or Parquet): numbers and times, checked by row."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from shared.errors import DomainError


def numbers(table: pd.DataFrame, name: str, field: str) -> npt.NDArray[np.float64]:
    """A column as float64 (n,), NaN where it is empty; DomainError naming the first row that holds no number."""
    column = table[name]
    values = pd.to_numeric(column, errors="coerce")
    _refuse(column, values.isna() & column.notna(), field, "a number")
    return values.to_numpy(dtype=np.float64, na_value=np.nan)


def times(table: pd.DataFrame, name: str, field: str) -> pd.Series:
    """A column as times in UTC; DomainError naming the first row that holds none."""
    values = pd.to_datetime(table[name], utc=True, errors="coerce")
    _refuse(table[name], values.isna(), field, "an ISO 8601 time")
    return values


def _refuse(column: pd.Series, bad: pd.Series, field: str, accepted: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad.to_numpy())[0])
        value = column.iloc[row]
        raise DomainError(
            f"Row {row} of column '{column.name}' holds {value!r}.", field=field, value=str(value), accepted=accepted
        )
