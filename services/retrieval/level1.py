"""Reader of CYGNSS level-1 v3 netCDF by its real variable names, lazily and in chunks of samples.

Variable names and fills follow the CYGNSS data dictionary (UM 148-0346). A real daily file has a scalar
``spacecraft_num``; files with several satellites carry it per sample. Both are read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from shared.errors import DomainError

MAP_DIMENSIONS = ("sample", "ddm", "delay", "doppler")
SHAPES = {(17, 11): "nominal", (69, 111): "raw-if"}
REQUIRED = (
    "sp_lat",
    "sp_lon",
    "sp_inc_angle",
    "sp_rx_gain",
    "gps_eirp",
    "rx_to_sp_range",
    "tx_to_sp_range",
    "prn_code",
    "quality_flags",
)
OPTIONAL = (
    "ddm_snr",
    "ddm_noise_floor",
    "quality_flags_2",
    "sp_land_valid",
    "sp_land_confidence",
    "pekel_sp_water_percentage_5km",
    "coherency_ratio",
    "srtm_dem_alt",
    "srtm_slope",
    "modis_land_cover",
    "image_id",
)


@dataclass(frozen=True)
class Chunk:
    """Maps of one mode with their metadata: ``metadata`` has a row a map, ``power_w`` is (map, delay, Doppler).

    Metadata columns are the level-1 names plus ``time`` (UTC, naive ms), ``satellite`` number, ``ddm``; fill is NaN.
    Maps that hold fill are zero and their ``all_fill`` is true.
    """

    mode: str
    delay_resolution_chips: float
    doppler_resolution_hz: float
    metadata: pd.DataFrame
    power_w: NDArray[np.float32]


def read_level1(path: str | Path, chunk_samples: int | None = None) -> Iterator[Chunk]:
    """Yield the file's maps in chunks of samples; DomainError names what is unreadable, missing or misshapen."""
    file = _open(path)
    with file:
        file.set_auto_maskandscale(False)
        mode = _check_layout(file, Path(path).name)
        samples = file.dimensions["sample"].size
        step = chunk_samples or (4096 if mode == "nominal" else 128)
        resolution = _resolutions(file, mode)
        for start in range(0, max(samples, 1), step):  # a file without samples is one empty chunk
            rows = slice(start, min(start + step, samples))
            try:
                yield _read_chunk(file, rows, mode, resolution)
            except (OSError, RuntimeError) as error:
                raise DomainError(
                    f"'{Path(path).name}' breaks off in samples {rows.start}..{rows.stop}: {error}",
                    field="observations",
                    value=Path(path).name,
                    accepted="a complete file",
                ) from error


def _open(path: str | Path) -> netCDF4.Dataset:
    try:
        return netCDF4.Dataset(str(path), "r")
    except (OSError, RuntimeError) as error:
        raise DomainError(
            f"'{Path(path).name}' cannot be read as netCDF (truncated or another format): {error}",
            field="observations",
            value=Path(path).name,
            accepted="a CYGNSS level-1 v3 netCDF-4 file",
        ) from error


def _check_layout(file: netCDF4.Dataset, name: str) -> str:
    missing = [v for v in ("power_analog", "ddm_timestamp_utc", *REQUIRED) if v not in file.variables]
    if missing:
        raise DomainError(
            f"'{name}' lacks the level-1 variable(s) {', '.join(missing)}.",
            field=missing[0],
            accepted="CYGNSS level-1 v3 names",
        )
    power = file.variables["power_analog"]
    shape = tuple(power.shape[2:])
    if power.dimensions != MAP_DIMENSIONS or shape not in SHAPES:
        hint = "; delay and Doppler are swapped" if shape[::-1] in SHAPES else ""
        raise DomainError(
            f"'{name}': power_analog has dimensions {power.dimensions} of size {power.shape}{hint}.",
            field="power_analog",
            value=f"{power.dimensions} {power.shape}",
            accepted="(sample, ddm, delay, doppler) with 17 x 11 or 69 x 111 bins",
        )
    return SHAPES[shape]


def _resolutions(file: netCDF4.Dataset, mode: str) -> tuple[float, float]:
    standard = (0.2552, 500.0) if mode == "nominal" else (0.0638, 50.0)
    names = ("delay_resolution", "dopp_resolution")
    found = [float(np.ravel(file.variables[n][...])[0]) if n in file.variables else 0.0 for n in names]
    return tuple(value if value > 0 else usual for value, usual in zip(found, standard, strict=True))


def _read_chunk(file: netCDF4.Dataset, rows: slice, mode: str, resolution: tuple[float, float]) -> Chunk:
    power_variable = file.variables["power_analog"]
    power = power_variable[rows]
    samples, channels = power.shape[:2]
    columns: dict[str, NDArray] = {
        "time": np.repeat(_times(file.variables["ddm_timestamp_utc"], rows), channels),
        "satellite": np.repeat(_satellites(file, rows, samples), channels),
        "ddm": np.tile(np.arange(channels), samples),
    }
    for name in (*REQUIRED, *OPTIONAL):
        columns[name] = _values(file, name, rows, samples * channels)
    maps = power.reshape(samples * channels, *power.shape[2:]).astype(np.float32, copy=False)
    fill = maps == np.float32(getattr(power_variable, "_FillValue", -9999.0))
    bad = fill | ~np.isfinite(maps)
    columns["all_fill"] = bad.all(axis=(1, 2))
    columns["part_fill"] = bad.any(axis=(1, 2)) & ~columns["all_fill"]
    return Chunk(mode, *resolution, metadata=pd.DataFrame(columns), power_w=np.where(bad, np.float32(0.0), maps))


def _values(file: netCDF4.Dataset, name: str, rows: slice, size: int) -> NDArray:
    """One per-map variable, fill as NaN (flags: fill as 0); absent optional variables are NaN."""
    if name not in file.variables:
        return np.full(size, np.nan)
    variable = file.variables[name]
    raw = variable[rows].reshape(-1)
    fill = raw == getattr(variable, "_FillValue", -9999)
    if name.startswith("quality_flags"):
        return np.where(fill, 0, raw).astype(np.uint32)
    return np.where(fill, np.nan, raw.astype(np.float64))


def _times(variable: netCDF4.Variable, rows: slice) -> NDArray[np.datetime64]:
    """Sample times as naive UTC milliseconds; ``seconds since`` may carry nanoseconds, as real files do."""
    words = str(getattr(variable, "units", "")).split(" since ")
    if len(words) != 2 or not words[0].startswith("sec"):
        raise DomainError(
            "ddm_timestamp_utc has no usable units.",
            field="ddm_timestamp_utc",
            value=getattr(variable, "units", ""),
            accepted="seconds since YYYY-MM-DD hh:mm:ss",
        )
    start = np.datetime64(words[1].strip().replace("Z", "").replace(" ", "T"), "ns").astype(np.int64)
    milliseconds = np.round(variable[rows] * 1e3 + start / 1e6).astype(np.int64)
    return milliseconds.astype("datetime64[ms]")


def _satellites(file: netCDF4.Dataset, rows: slice, samples: int) -> NDArray[np.int64]:
    if "spacecraft_num" not in file.variables:
        return np.zeros(samples, dtype=np.int64)
    variable = file.variables["spacecraft_num"]
    if variable.dimensions == ("sample",):
        return variable[rows].astype(np.int64)
    return np.full(samples, int(np.ravel(variable[...])[0]), dtype=np.int64)


def is_simulated(path: str | Path) -> bool:
    """True where the file says that its maps are simulated; DomainError where it is no netCDF."""
    with _open(path) as file:
        return str(getattr(file, "simulated", "false")).lower() == "true"
