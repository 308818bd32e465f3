"""Reader of CYGNSS level-1 v3 netCDF by its real variable names, lazily and in chunks of samples.

Variable names and fills follow the CYGNSS data dictionary (UM 148-0346). A real daily file has a scalar
``spacecraft_num``; files with several satellites carry it per sample. Both are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
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
    "reflectivity_peak",
    "quality_flags_2",
    "sp_land_valid",
    "sp_land_confidence",
    "pekel_sp_water_percentage_5km",
    "coherency_ratio",
    "coherency_state",
    "brcs_ddm_peak_bin_delay_row",
    "brcs_ddm_peak_bin_dopp_col",
    "track_id",
    "srtm_dem_alt",
    "srtm_slope",
    "modis_land_cover",
    "image_id",
)
FURTHER_MAPS = ("brcs", "raw_counts", "eff_scatter")
FILLS = (-9999.0, -99999999.0)  # of the data dictionary, also where a variable names none
ABSURD = 1e30  # netCDF's own fill of values never written


@dataclass(frozen=True)
class Chunk:
    """Maps of one mode with their metadata: ``metadata`` has a row a map, ``power_w`` is (map, delay, Doppler).

    Metadata columns are the level-1 names plus ``time`` (UTC, naive ms), ``satellite`` number, ``ddm``; fill is NaN.
    Bins of fill are zero in ``power_w``; ``all_fill`` or ``part_fill`` is true of their map. ``further`` holds other
    maps that were asked for, by name (m2, counts), fill as NaN.
    """

    mode: str
    delay_resolution_chips: float
    doppler_resolution_hz: float
    metadata: pd.DataFrame
    power_w: NDArray[np.float32]
    further: dict[str, NDArray[np.float32]] = field(default_factory=dict)


def read_level1(
    path: str | Path, chunk_samples: int | None = None, further_maps: Sequence[str] = ()
) -> Iterator[Chunk]:
    """Yield the file's maps in chunks of samples; DomainError names what is unreadable, missing or misshapen.

    Nothing but a chunk is held: 4,096 samples of four nominal maps (12 MB) or 128 of raw-IF, where
    ``chunk_samples`` is not given. ``further_maps`` of FURTHER_MAPS are read beside ``power_analog``.
    """
    file = _open(path)
    with file:
        file.set_auto_maskandscale(False)
        mode = _check_layout(file, Path(path).name)
        for name in further_maps:
            _check_map(file, name, Path(path).name)
        samples = file.dimensions["sample"].size
        step = chunk_samples or (4096 if mode == "nominal" else 128)
        resolution = _resolutions(file, mode)
        for start in range(0, max(samples, 1), step):  # a file without samples is one empty chunk
            rows = slice(start, min(start + step, samples))
            try:
                yield _read_chunk(file, rows, mode, resolution, further_maps)
            except (OSError, RuntimeError) as error:
                raise DomainError(
                    f"'{Path(path).name}' breaks off in samples {rows.start}..{rows.stop}: {_cause(error)}",
                    field="observations",
                    value=Path(path).name,
                    accepted="a complete file",
                ) from error


def _open(path: str | Path) -> netCDF4.Dataset:
    try:
        return netCDF4.Dataset(str(path), "r")
    except (OSError, RuntimeError) as error:
        raise DomainError(
            f"'{Path(path).name}' cannot be read as netCDF (truncated or another format): {_cause(error)}",
            field="observations",
            value=Path(path).name,
            accepted="a CYGNSS level-1 v3 netCDF-4 file",
        ) from error


def _cause(error: Exception) -> str:
    """What the library says, without the path that it adds."""
    return str(getattr(error, "strerror", None) or error)


def _check_layout(file: netCDF4.Dataset, name: str) -> str:
    missing = [v for v in ("power_analog", "ddm_timestamp_utc", *REQUIRED) if v not in file.variables]
    if missing:
        raise DomainError(
            f"'{name}' lacks the level-1 variable(s) {', '.join(missing)}.",
            field=missing[0],
            accepted="CYGNSS level-1 v3 names",
        )
    _check_dimensions(file, "ddm_timestamp_utc", ("sample",), name)
    for variable in (*REQUIRED, *OPTIONAL):
        if variable in file.variables:
            _check_dimensions(file, variable, MAP_DIMENSIONS[:2], name)
    return _check_map(file, "power_analog", name)


def _check_dimensions(file: netCDF4.Dataset, variable: str, dimensions: tuple[str, ...], name: str) -> None:
    found = file.variables[variable]
    if found.dimensions != dimensions or not np.issubdtype(found.dtype, np.number):
        raise DomainError(
            f"'{name}': {variable} is {found.dtype} with dimensions {found.dimensions}.",
            field=variable,
            value=f"{found.dimensions} {found.shape}",
            accepted=f"numbers with dimensions ({', '.join(dimensions)})",
        )


def _check_map(file: netCDF4.Dataset, variable: str, name: str) -> str:
    """The mode that a map variable's shape means."""
    if variable not in file.variables:
        raise DomainError(f"'{name}' lacks {variable}.", field=variable, accepted=", ".join(FURTHER_MAPS))
    power = file.variables[variable]
    shape = tuple(power.shape[2:])
    if power.dimensions != MAP_DIMENSIONS or shape not in SHAPES:
        hint = "; delay and Doppler are swapped" if shape[::-1] in SHAPES else ""
        raise DomainError(
            f"'{name}': {variable} has dimensions {power.dimensions} of size {power.shape}{hint}.",
            field=variable,
            value=f"{power.dimensions} {power.shape}",
            accepted="(sample, ddm, delay, doppler) with 17 x 11 or 69 x 111 bins",
        )
    return SHAPES[shape]


def _resolutions(file: netCDF4.Dataset, mode: str) -> tuple[float, float]:
    standard = (0.2552, 500.0) if mode == "nominal" else (0.0638, 50.0)
    names = ("delay_resolution", "dopp_resolution")
    found = [float(np.ravel(file.variables[n][...])[0]) if n in file.variables else 0.0 for n in names]
    return tuple(value if value > 0 else usual for value, usual in zip(found, standard, strict=True))


def _read_chunk(
    file: netCDF4.Dataset, rows: slice, mode: str, resolution: tuple[float, float], further_maps: Sequence[str]
) -> Chunk:
    power = file.variables["power_analog"]
    samples, channels = rows.stop - rows.start, power.shape[1]
    columns: dict[str, NDArray] = {
        "time": np.repeat(_times(file.variables["ddm_timestamp_utc"], rows), channels),
        "satellite": np.repeat(_satellites(file, rows, samples), channels),
        "ddm": np.tile(np.arange(channels), samples),
    }
    for name in (*REQUIRED, *OPTIONAL):
        columns[name] = _values(file, name, rows, samples * channels)
    maps = _maps(power, rows)
    bad = np.isnan(maps)
    columns["all_fill"] = bad.all(axis=(1, 2))
    columns["part_fill"] = bad.any(axis=(1, 2)) & ~columns["all_fill"]
    maps[bad] = 0.0
    further = {name: _maps(file.variables[name], rows) for name in further_maps}
    return Chunk(mode, *resolution, metadata=pd.DataFrame(columns), power_w=maps, further=further)


def _maps(variable: netCDF4.Variable, rows: slice) -> NDArray[np.float32]:
    """Maps of all channels, (sample x ddm, delay, Doppler), fill as NaN."""
    raw = variable[rows]
    values = raw.reshape(-1, *raw.shape[2:]).astype(np.float32)
    values[_is_fill(variable, raw).reshape(values.shape) | ~np.isfinite(values)] = np.nan
    return values


def _is_fill(variable: netCDF4.Variable, raw: NDArray) -> NDArray[np.bool_]:
    """True where a raw value stands for none: the variable's own fill, the dictionary's, or never written."""
    own = [getattr(variable, name) for name in ("_FillValue", "missing_value") if hasattr(variable, name)]
    fill = np.isin(raw, np.asarray([*own, *FILLS], dtype=raw.dtype if raw.dtype.kind == "f" else np.float64))
    return fill | (np.abs(raw) > ABSURD) if raw.dtype.kind == "f" else fill


def _values(file: netCDF4.Dataset, name: str, rows: slice, size: int) -> NDArray:
    """One per-map variable as float64 (flags of 32 bits fit), fill as NaN; absent optional variables are NaN."""
    if name not in file.variables:
        return np.full(size, np.nan)
    variable = file.variables[name]
    raw = variable[rows].reshape(-1)
    return np.where(_is_fill(variable, raw), np.nan, raw.astype(np.float64))


def _times(variable: netCDF4.Variable, rows: slice) -> NDArray[np.datetime64]:
    """Sample times as naive UTC milliseconds; ``seconds since`` may carry nanoseconds, as real files do."""
    start = _time_origin(str(getattr(variable, "units", "")))
    seconds = variable[rows]
    known = np.isfinite(seconds) & ~_is_fill(variable, seconds)
    milliseconds = np.round(np.where(known, seconds, 0.0) * 1e3 + start / 1e6).astype(np.int64)
    return np.where(known, milliseconds.astype("datetime64[ms]"), np.datetime64("NaT", "ms"))


def _time_origin(units: str) -> int:
    """Nanoseconds since 1970 of ``seconds since ...``, UTC where no zone is given."""
    words = units.split(" since ")
    try:
        if len(words) != 2 or words[0].strip() not in ("s", "sec", "second", "seconds"):
            raise ValueError("no seconds")
        moment = pd.Timestamp(words[1].strip())
        return int(
            (moment if moment.tzinfo is None else moment.tz_convert("UTC").tz_localize(None)).as_unit("ns").value
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise DomainError(
            "ddm_timestamp_utc has no usable units.",
            field="ddm_timestamp_utc",
            value=units,
            accepted="seconds since YYYY-MM-DD hh:mm:ss",
        ) from error


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
