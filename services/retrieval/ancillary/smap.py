"""Soil moisture of SMAP on EASE-Grid 2.0 cells, from level-3 files (HDF5) or tables of their subsets.

Level-3 radiometer files (SPL3SMP, 36 km; SPL3SMP_E, 9 km) hold the groups ``Soil_Moisture_Retrieval_Data_AM`` and
``_PM`` with ``soil_moisture``, ``latitude``, ``longitude`` and ``retrieval_qual_flag`` (O'Neill et al., NSIDC user
guide); the PM group adds ``_pm`` to the names. Fill is -9999; bit 0 of the flag set: quality not recommended.
"""

from __future__ import annotations

import re
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.ease_grid import row_column
from shared.errors import DomainError

COLUMNS = ("time", "row", "column", "soil_moisture")
OVERPASS_H = {"AM": 6, "PM": 18}  # local solar time of the two passes
VALID = (0.02, 0.65)  # m3/m3: the range that the algorithm may return
MAX_AGE_DAYS = 10.0


def read_smap(path: str | Path, name: str | None = None, *, resolution_km: int = 9) -> pd.DataFrame:
    """A table ``time`` (naive UTC), ``row``, ``column``, ``soil_moisture`` (m3/m3) of a SMAP file or Parquet table.

    The day stands in the file name (``_YYYYMMDD_`` or ``YYYY-MM-DD``); ``name`` is that of the artifact where the
    path has another. DomainError where the file, its names or its day cannot be read.
    """
    title = name or Path(path).name
    with open(path, "rb") as file:
        if file.read(4) == b"PAR1":
            return _from_parquet(path, title)
    try:
        opened = netCDF4.Dataset(str(path))
    except (OSError, RuntimeError) as error:
        raise DomainError(
            f"'{title}' cannot be read as SMAP (HDF5): {error}", field="soil_moisture", value=title
        ) from error
    with opened as file:
        day = _day(title)
        groups = {half: file.groups.get(f"Soil_Moisture_Retrieval_Data_{half}") for half in OVERPASS_H}
        parts = [_retrieved(group, half, day) for half, group in groups.items() if group is not None]
        if not parts:
            parts = [_retrieved(file, "AM", day)]
    table = pd.concat(parts, ignore_index=True)
    row, column = row_column(table["latitude_deg"].to_numpy(), table["longitude_deg"].to_numpy(), resolution_km)
    return table.assign(row=row, column=column)[row >= 0][list(COLUMNS)].reset_index(drop=True)


def _retrieved(group: netCDF4.Dataset, half: str, day: np.datetime64) -> pd.DataFrame:
    """Recommended retrievals of a half day; each at its overpass, local solar time turned into UTC."""
    suffix = "_pm" if half == "PM" and "soil_moisture_pm" in group.variables else ""
    missing = [n + suffix for n in ("soil_moisture", "latitude", "longitude") if n + suffix not in group.variables]
    if missing:
        raise DomainError(
            f"The SMAP file lacks {', '.join(missing)}.",
            field=missing[0],
            value=", ".join(group.variables),
            accepted="soil_moisture, latitude, longitude",
        )
    read = {n: _flat(group.variables[n + suffix]) for n in ("soil_moisture", "latitude", "longitude")}
    flag_name = "retrieval_qual_flag" + suffix
    flag = _flat(group.variables[flag_name]) if flag_name in group.variables else np.zeros(len(read["latitude"]))
    good = np.isfinite(read["latitude"]) & np.isfinite(read["longitude"]) & (np.abs(read["latitude"]) <= 90)
    good &= (read["soil_moisture"] >= VALID[0]) & (read["soil_moisture"] <= VALID[1])
    good &= (np.nan_to_num(flag, nan=1.0).astype(np.int64) & 1) == 0
    longitude = (read["longitude"][good] + 180.0) % 360.0 - 180.0
    hours = OVERPASS_H[half] - longitude / 15.0
    return pd.DataFrame(
        {
            "time": day + np.round(hours * 3.6e6).astype("timedelta64[ms]"),
            "latitude_deg": read["latitude"][good],
            "longitude_deg": longitude,
            "soil_moisture": read["soil_moisture"][good],
        }
    )


def _flat(variable: netCDF4.Variable) -> NDArray[np.float64]:
    variable.set_auto_maskandscale(False)
    values = np.ravel(variable[...]).astype(np.float64)
    fill = float(getattr(variable, "_FillValue", -9999.0))
    return np.where((values == fill) | (values == -9999.0), np.nan, values)


def _day(title: str) -> np.datetime64:
    found = re.search(r"(?<!\d)(20\d\d)-?([01]\d)-?([0-3]\d)(?!\d)", title)
    if not found:
        raise DomainError(
            f"The name '{title}' holds no day.", field="soil_moisture", value=title, accepted="..._YYYYMMDD_..."
        )
    return np.datetime64("-".join(found.groups()), "ms")


def _from_parquet(path: str | Path, title: str) -> pd.DataFrame:
    try:
        table = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise DomainError(f"'{title}' cannot be read as Parquet: {error}", field="soil_moisture") from error
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise DomainError(
            f"'{title}' lacks {', '.join(missing)}.",
            field=f"soil_moisture.{missing[0]}",
            accepted=", ".join(COLUMNS),
        )
    time = pd.to_datetime(table["time"], utc=True).dt.tz_localize(None)
    return table.assign(time=time.to_numpy().astype("datetime64[ms]"))[list(COLUMNS)]


def latest_before(
    looks: pd.DataFrame, table: pd.DataFrame, *, resolution_km: int = 9, max_age_days: float = MAX_AGE_DAYS
) -> NDArray[np.float64]:
    """The cell's last soil moisture before each look (never a later one), at most ``max_age_days`` old, (n,); NaN."""
    row, column = row_column(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy(), resolution_km)
    left = pd.DataFrame({"time": looks["time"].to_numpy().astype("datetime64[ms]"), "row": row, "column": column})
    left = left.astype({"row": np.int64, "column": np.int64}).assign(look=np.arange(len(left)))
    right = table.astype({"row": np.int64, "column": np.int64}).sort_values("time", kind="stable")
    joined = pd.merge_asof(
        left.sort_values("time", kind="stable"),
        right,
        on="time",
        by=["row", "column"],
        tolerance=pd.Timedelta(days=max_age_days),
    )
    return joined.sort_values("look")["soil_moisture"].to_numpy(dtype=np.float64)
