"""Writer of level-1 shaped netCDF: the real CYGNSS v3 variable names, dimensions and fill values.

The dictionary is UM 148-0346; the dimensions are sample, ddm, delay, doppler. Unlike a real daily file one file may
hold several satellites: ``spacecraft_num`` then has the dimension sample. The global attribute ``simulated`` says
whether the maps are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.constants import FILL, WAVELENGTH_M

CHANNELS = 4  # CYGNSS tracks four reflections at a time
INTEGER_FILL = -99999999
COUNTS_OF_NOISE = 10_000.0  # raw counts of the mean noise floor


@dataclass(frozen=True)
class MapLayout:
    """Mode, bins and steps of the maps of one file."""

    mode: str
    delays: int
    dopplers: int
    delay_resolution_chips: float
    doppler_resolution_hz: float


FLOATS: dict[str, tuple[str, str]] = {
    "sp_lat": ("latitude_deg", "degrees_north"),
    "sp_lon": ("longitude_east_deg", "degrees_east"),
    "sp_inc_angle": ("incidence_deg", "degree"),
    "sp_rx_gain": ("rx_gain_dbi", "dBi"),
    "gps_eirp": ("reported_eirp_w", "watt"),
    "ddm_snr": ("snr_db", "dB"),
    "ddm_noise_floor": ("noise_counts", "1"),
    "coherency_ratio": ("coherency_ratio", "1"),
    "pekel_sp_water_percentage_5km": ("water_pct", "percent"),
    "brcs_ddm_sp_bin_delay_row": ("specular_row", "1"),
    "brcs_ddm_sp_bin_dopp_col": ("specular_column", "1"),
}
INTEGERS: dict[str, tuple[str, str]] = {
    "rx_to_sp_range": ("rx_range_m", "meter"),
    "tx_to_sp_range": ("tx_range_m", "meter"),
    "prn_code": ("prn", "1"),
    "quality_flags": ("quality_flags", "1"),
    "quality_flags_2": ("quality_flags_2", "1"),
    "sp_land_valid": ("land_valid", "1"),
    "sp_land_confidence": ("land_confidence", "1"),
}


def write_level1(
    path: str | Path,
    looks: pd.DataFrame,
    maps: NDArray[np.float32],
    layout: MapLayout,
    noise_floor_w: float,
    attributes: Mapping[str, Any],
) -> None:
    """Write maps (n, delay, Doppler; W) and their looks (columns of FLOATS and INTEGERS, ``sample``, ``ddm``,
    ``time_ms``, ``spacecraft``).
    """
    samples = int(looks["sample"].max()) + 1 if len(looks) else 0
    slot = looks["sample"].to_numpy(np.intp) * CHANNELS + looks["ddm"].to_numpy(np.intp)
    with netCDF4.Dataset(str(path), "w", format="NETCDF4") as file:
        for name, size in (
            ("sample", samples),
            ("ddm", CHANNELS),
            ("delay", layout.delays),
            ("doppler", layout.dopplers),
        ):
            file.createDimension(name, size)
        _write_sample_axis(file, looks, samples)
        for name, (column, unit) in FLOATS.items():
            _put(file, name, "f4", FILL, unit, looks[column].to_numpy(), slot, samples)
        for name, (column, unit) in INTEGERS.items():
            _put(file, name, "i4", INTEGER_FILL, unit, looks[column].to_numpy(), slot, samples)
        if "image_id" in looks.columns:
            _put(file, "image_id", "i4", INTEGER_FILL, "1", looks["image_id"].to_numpy(), slot, samples)
        _write_maps(file, maps, looks, slot, samples, layout, noise_floor_w)
        _scalar(file, "delay_resolution", layout.delay_resolution_chips, "1")
        _scalar(file, "dopp_resolution", layout.doppler_resolution_hz, "s-1")
        start_ms = int(looks["time_ms"].min()) if len(looks) else 0
        own = {
            "time_coverage_start": _iso(start_ms // 1000 * 1000),
            "processing_level": "1",
            "observation_mode": layout.mode,
            "title": f"CYGNSS level-1 delay-Doppler maps, {layout.mode}",
        }
        merged = {"Conventions": "CF-1.11, ACDD-1.3", **own, **attributes}
        file.setncatts({name: _plain(merged[name]) for name in sorted(merged)})


def _write_sample_axis(file: netCDF4.Dataset, looks: pd.DataFrame, samples: int) -> None:
    first = looks.drop_duplicates("sample")
    start_ms = int(looks["time_ms"].min()) // 1000 * 1000 if len(looks) else 0
    seconds = np.zeros(samples)
    seconds[first["sample"].to_numpy(np.intp)] = (first["time_ms"].to_numpy() - start_ms) / 1000.0
    time = file.createVariable("ddm_timestamp_utc", "f8", ("sample",), zlib=True, complevel=1)
    time.setncatts({"units": f"seconds since {_iso(start_ms)}", "calendar": "standard", "long_name": "DDM time, UTC"})
    time[:] = seconds
    number = file.createVariable("spacecraft_num", "i2", ("sample",), zlib=True, complevel=1)
    values = np.zeros(samples, dtype=np.int16)
    values[first["sample"].to_numpy(np.intp)] = first["spacecraft"].to_numpy()
    number[:] = values


def _put(file: netCDF4.Dataset, name: str, kind: str, fill: float, unit: str, values: NDArray, slot, samples) -> None:
    variable = file.createVariable(name, kind, ("sample", "ddm"), fill_value=fill, zlib=True, complevel=1)
    variable.setncatts({"units": unit})
    full = np.full(samples * CHANNELS, fill, dtype=kind)
    full[slot] = np.round(values) if kind == "i4" else values
    variable[:] = full.reshape(samples, CHANNELS)


def _section_per_watt(looks: pd.DataFrame) -> NDArray[np.float32]:
    """Bistatic radar cross section of a watt: (4 pi)^3 Rt^2 Rr^2 / (EIRP G lambda^2), m2/W, (n,); NaN without geometry.

    Ruf et al. 2016, CYGNSS handbook.
    """
    rx_m, tx_m = (looks[name].to_numpy(np.float64) for name in ("rx_range_m", "tx_range_m"))
    eirp_w, gain_dbi = (looks[name].to_numpy(np.float64) for name in ("reported_eirp_w", "rx_gain_dbi"))
    known = (rx_m > 0) & (tx_m > 0) & (eirp_w > 0) & (gain_dbi > FILL)
    gain = 10.0 ** (np.where(known, gain_dbi, 0.0) / 10.0)
    area = (4.0 * np.pi) ** 3 * (rx_m * tx_m) ** 2 / (np.where(known, eirp_w, 1.0) * gain * WAVELENGTH_M**2)
    return np.where(known, area, np.nan).astype(np.float32)


def _write_maps(file, maps, looks: pd.DataFrame, slot, samples: int, layout: MapLayout, noise_floor_w: float) -> None:
    """power_analog (W, noise floor removed), brcs and raw_counts (floor included), in chunks of whole samples."""
    chunk = max(1, min(samples, 256 if layout.mode == "nominal" else 8))
    sizes = (chunk, CHANNELS, layout.delays, layout.dopplers) if samples else None
    power = _map_variable(file, "power_analog", "f4", FILL, "watt", "DDM bin analog power", sizes)
    section = _map_variable(file, "brcs", "f4", FILL, "meter2", "DDM bin bistatic radar cross section", sizes)
    counts = _map_variable(file, "raw_counts", "i4", INTEGER_FILL, "1", "DDM bin raw counts", sizes)
    kept, per_watt = _keep_bits(maps), _section_per_watt(looks)
    for first in range(0, samples, chunk * 16):
        last = min(first + chunk * 16, samples)
        here = (slot >= first * CHANNELS) & (slot < last * CHANNELS)
        shape = (last - first, CHANNELS, layout.delays, layout.dopplers)
        watts, place = kept[here], slot[here] - first * CHANNELS
        area = _keep_bits(watts * per_watt[here, None, None])
        power[first:last] = _placed(watts, place, shape, FILL)
        section[first:last] = _placed(np.where(np.isfinite(area), area, np.float32(FILL)), place, shape, FILL)
        whole = np.round((watts / noise_floor_w + 1.0) * COUNTS_OF_NOISE).astype(np.int32)
        counts[first:last] = _placed(whole, place, shape, INTEGER_FILL)


def _map_variable(file, name: str, kind: str, fill: float, unit: str, text: str, sizes) -> netCDF4.Variable:
    options = {"zlib": True, "complevel": 1, "shuffle": True, "chunksizes": sizes}
    variable = file.createVariable(name, kind, ("sample", "ddm", "delay", "doppler"), fill_value=fill, **options)
    variable.setncatts({"units": unit, "long_name": text})
    return variable


def _placed(maps: NDArray, place: NDArray[np.intp], shape: tuple[int, ...], fill: float) -> NDArray:
    """Maps at their places in a block of samples, fill elsewhere."""
    full = np.full((shape[0] * shape[1], *shape[2:]), fill, dtype=maps.dtype)
    full[place] = maps
    return full.reshape(shape)


def _keep_bits(values: NDArray[np.float32], bits: int = 10) -> NDArray[np.float32]:
    """Round the mantissa to ``bits`` bits (0.05 % of the value) so that the maps compress."""
    drop = np.uint32(23 - bits)
    raw = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)
    half = np.uint32(1) << (drop - np.uint32(1))
    return ((raw + half) & ~((np.uint32(1) << drop) - np.uint32(1))).view(np.float32)


def _scalar(file: netCDF4.Dataset, name: str, value: float, unit: str) -> None:
    variable = file.createVariable(name, "f4")
    variable.setncatts({"units": unit})
    variable[...] = value


def _iso(milliseconds: int) -> str:
    return str(np.datetime64(milliseconds, "ms").astype("datetime64[s]")) + "Z"


def _plain(value: Any) -> Any:
    if value is None:
        return ""
    return ("true" if value else "false") if isinstance(value, bool | np.bool_) else value
