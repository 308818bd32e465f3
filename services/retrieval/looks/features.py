"""Features of delay-Doppler maps: strength, shape and texture, in units that hold for both map sizes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numba
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.ease_grid import row_column
from services.retrieval.level1.land_screening import LandLimits, screen_land
from services.retrieval.level1.reader import Chunk, read_level1
from services.retrieval.level1.reflectivity import footprint_m, reflectivity_db
from services.retrieval.looks.texture import PROPERTIES, quantise, texture
from shared.fan_out import fan_out

LOOK_S = {"nominal": 0.5, "raw-if": 1.0}
SHAPE_FEATURES = (
    "delay_width_chips",
    "doppler_width_hz",
    "leading_slope",
    "trailing_slope",
    "volume_near",
    "volume_far",
    "coherence",
    "doppler_spread_hz",
    "roughness_of_floor",
)
TEXTURE_FEATURES = tuple(f"texture_{name}" for name in PROPERTIES) + tuple(f"texture_{n}_range" for n in PROPERTIES)
STRENGTH_FEATURES = ("reflectivity_db", "snr_db", "incidence_deg", "rx_gain_dbi")


@dataclass(frozen=True)
class Observations:
    """Usable looks of all files (a row each) and the count of maps read and screened out, by reason and mode."""

    looks: pd.DataFrame
    screening: dict[str, dict[str, int]] = field(default_factory=dict)


@numba.njit(cache=True)
def _shape(maps, delay_step, doppler_step):
    """Shape features (n, 9) of maps normalised to their own peak, see SHAPE_FEATURES."""
    count, rows, columns = maps.shape
    result = np.empty((count, 9), np.float64)
    near_rows = round(0.26 / delay_step)
    near_columns = round(500.0 / doppler_step)
    chip_rows = max(1, round(1.0 / delay_step))
    for n in range(count):
        peak = maps[n, 0, 0]
        row, column = 0, 0
        for i in range(rows):
            for j in range(columns):
                if maps[n, i, j] > peak:
                    peak, row, column = maps[n, i, j], i, j
        above_rows, above_columns = 0, 0
        for i in range(rows):
            above_rows += maps[n, i, column] > 0.5 * peak
        weight, first, second = 0.0, 0.0, 0.0
        for j in range(columns):
            above_columns += maps[n, row, j] > 0.5 * peak
            value = max(maps[n, row, j], 0.0)
            weight += value
            first += value * j
            second += value * j * j
        near, far, floor_sum, floor_squares, floor_count = 0.0, 0.0, 0.0, 0.0, 0
        for i in range(rows):
            for j in range(columns):
                value = maps[n, i, j] / peak
                if abs(i - row) <= near_rows and abs(j - column) <= near_columns:
                    near += value
                else:
                    far += value
                if i < row - chip_rows - 1:
                    floor_sum += value
                    floor_squares += value * value
                    floor_count += 1
        cell = delay_step * doppler_step / 500.0
        before = maps[n, max(row - chip_rows, 0), column] / peak
        after = maps[n, min(row + chip_rows, rows - 1), column] / peak
        centre = first / weight
        mean = floor_sum / max(floor_count, 1)
        result[n, 0] = above_rows * delay_step
        result[n, 1] = above_columns * doppler_step
        result[n, 2] = 1.0 - before
        result[n, 3] = 1.0 - after
        result[n, 4] = near * cell
        result[n, 5] = far * cell
        result[n, 6] = near / max(abs(far), 1e-6)
        result[n, 7] = np.sqrt(max(second / weight - centre * centre, 0.0)) * doppler_step
        result[n, 8] = np.sqrt(max(floor_squares / max(floor_count, 1) - mean * mean, 0.0))
    return result


def shape_features(maps_w: NDArray, delay_step_chips: float, doppler_step_hz: float) -> NDArray[np.float64]:
    """Shape of maps (n, delay, Doppler) with a positive peak, (n, 9): columns as SHAPE_FEATURES.

    Widths at half power through the peak (chips, Hz), drop one chip before and after the peak, volume within and
    beyond a quarter chip and 500 Hz (chips x 500 Hz, peak 1), their ratio (Al-Khaldi et al. 2021), Doppler spread,
    noise before the signal.
    """
    return _shape(np.ascontiguousarray(maps_w, dtype=np.float32), delay_step_chips, doppler_step_hz)


def texture_features(maps_w: NDArray) -> NDArray[np.float64]:
    """Mean over the four angles of each texture property, then their range over angles, (n, 6)."""
    angles = texture(quantise(maps_w))
    return np.concatenate([angles.mean(axis=1), np.ptp(angles, axis=1)], axis=1)


def look_features(chunk: Chunk, limits: LandLimits) -> tuple[pd.DataFrame, dict[str, int]]:
    """Features and position of a chunk's usable looks, and the counts of what was screened out and why."""
    power = chunk.power_w
    peak = power.max(axis=(1, 2)).astype(np.float64)
    usable, counts = screen_land(chunk.metadata, peak, limits)
    meta, maps, peak = chunk.metadata[usable].reset_index(drop=True), power[usable], peak[usable]
    frame = _position(meta, chunk.mode)
    frame["reflectivity_db"] = reflectivity_db(
        peak, meta["gps_eirp"], meta["sp_rx_gain"], meta["rx_to_sp_range"], meta["tx_to_sp_range"]
    ).to_numpy()
    frame["snr_db"] = meta["ddm_snr"].to_numpy()
    frame["rx_gain_dbi"] = meta["sp_rx_gain"].to_numpy()
    shape = shape_features(maps, chunk.delay_resolution_chips, chunk.doppler_resolution_hz)
    frame[list(SHAPE_FEATURES)] = shape
    frame[list(TEXTURE_FEATURES)] = texture_features(maps)
    return frame, {"read": len(power), "usable": int(usable.sum()), **counts}


def _position(meta: pd.DataFrame, mode: str) -> pd.DataFrame:
    incidence = meta["sp_inc_angle"].to_numpy()
    ranges = meta["rx_to_sp_range"].to_numpy(), meta["tx_to_sp_range"].to_numpy()
    along_m, across_m = footprint_m(incidence, *ranges, LOOK_S[mode])
    longitude = (meta["sp_lon"].to_numpy() + 180.0) % 360.0 - 180.0
    return pd.DataFrame(
        {
            "time": meta["time"].to_numpy(),
            "satellite": meta["satellite"].to_numpy(),
            "prn": meta["prn_code"].to_numpy(),
            "latitude_deg": meta["sp_lat"].to_numpy(),
            "longitude_deg": longitude,
            "along_m": along_m,
            "across_m": across_m,
            "incidence_deg": incidence,
            "mode": np.full(len(meta), mode, dtype=object),
            "height_m": meta["srtm_dem_alt"].to_numpy(),
            "slope_deg": meta["srtm_slope"].to_numpy(),
            "land_cover": meta["modis_land_cover"].to_numpy(),
        }
    )


def read_observations(
    paths: Iterable[str | Path],
    limits: LandLimits | None = None,
    time_from: np.datetime64 | None = None,
    time_to: np.datetime64 | None = None,
) -> Observations:
    """Features of all usable looks of level-1 files within [time_from, time_to), with 9 km EASE cells.

    DomainError where a file is unreadable or misshapen. No usable look at all gives an empty table, not an error: a
    clouded-out day is a fact.
    """
    tasks = [(str(path), limits or LandLimits(), time_from, time_to) for path in paths]
    granules = fan_out(granule_looks, tasks)
    screening: dict[str, dict[str, int]] = {}
    for _, counts in granules:
        for mode, reasons in counts.items():
            _add(screening.setdefault(mode, {}), reasons)
    frames = [frame for frame, _ in granules]
    looks = pd.concat([frame for frame in frames if len(frame)] or frames[:1], ignore_index=True)
    row, column = row_column(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy(), 9)
    for mode, count in looks.loc[row < 0, "mode"].value_counts().items():
        _add(screening[str(mode)], {"outside_grid": int(count)})
    return Observations(looks.assign(row=row, column=column)[row >= 0].reset_index(drop=True), screening)


def granule_looks(
    path: str, limits: LandLimits, time_from: np.datetime64 | None, time_to: np.datetime64 | None
) -> tuple[pd.DataFrame, dict[str, dict[str, int]]]:
    """Usable looks of one level-1 file within [time_from, time_to), and the counts of its screening by mode."""
    frames: list[pd.DataFrame] = []
    screening: dict[str, dict[str, int]] = {}
    for chunk in read_level1(path):
        frame, counts = look_features(chunk, limits)
        inside = _within(frame["time"], time_from, time_to)
        outside = {} if inside.all() else {"outside_time": int((~inside).sum())}
        _add(screening.setdefault(chunk.mode, {}), counts | outside)
        frames.append(frame[inside])
    return pd.concat([frame for frame in frames if len(frame)] or frames[:1], ignore_index=True), screening


def _add(total: dict[str, int], counts: dict[str, int]) -> None:
    for reason, count in counts.items():
        total[reason] = total.get(reason, 0) + count


def _within(time: pd.Series, start: np.datetime64 | None, end: np.datetime64 | None) -> NDArray[np.bool_]:
    inside = np.ones(len(time), dtype=bool)
    if start is not None:
        inside &= (time >= start).to_numpy()
    if end is not None:
        inside &= (time < end).to_numpy()
    return inside
