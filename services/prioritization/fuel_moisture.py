"""Dead fuel moisture, hour by hour: time-lag classes of 1, 10 and 100 h, corrected by stations where there are any.

Each class relaxes towards the equilibrium of the air (Simard 1968) with its time lag; rain drives it towards saturation
(thresholds and rates of WRFx's fuel moisture model: Mandel et al. 2014, Nat. Hazards Earth Syst. Sci. 14, 2829-2845).
The state carries, besides the three moistures, the error of the equilibrium itself, so that what a station taught lasts
into the forecast and reaches the classes that no station measures (Vejmelka et al. 2016, Int. J. Wildland Fire 25,
558-568). Moistures in per cent of dry weight, variances in per cent squared, times in hours.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization import indices
from services.prioritization.fuel_moisture_stations import FilterNoise, StationObservations, at_hours, screened
from services.prioritization.weather import WeatherGrid
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

LAG_H = np.array([1.0, 10.0, 100.0])
WETTING_LAG_H = 1.4 * LAG_H
RAIN_THRESHOLD_MM_H = 0.05
RAIN_SATURATING_MM_H = 8.0
SATURATION_PCT = 250.0
OBSERVED_CLASS = 1
BIAS_MEMORY_H = 240.0
BIAS_LIMIT_PCT = 15.0
BEYOND_GATE = "beyond the gate"


@dataclass(frozen=True)
class FilterState:
    """What the next hour resumes from: moistures and equilibrium error (4, n), and their covariance (n, 4, 4).

    ``probation``: by place (longitude, latitude) of a station, how many plausible values it still owes.
    """

    mean: Array
    covariance: Array
    probation: dict[tuple[float, float], int] = field(default_factory=dict)


@dataclass(frozen=True)
class FuelMoisture:
    """Moisture and its variance per hour, class (1, 10, 100 h) and cell: (t, 3, n); counts of what was refused.

    Cells whose weather is never known are NaN; ``hours_without_weather`` (n,) counts the hours that a cell was carried
    on without any. ``state`` resumes the run.
    """

    moisture_pct: Array
    variance: Array
    used: int
    refused: dict[str, int]
    hours_without_weather: npt.NDArray[np.int64]
    state: FilterState


def step(moisture_pct: Array, equilibrium_pct: Array, rain_mm_h: Array, hours: float) -> tuple[Array, Array, Array]:
    """Moisture (3, n) after ``hours`` of steady air; also what of the old moisture and of an equilibrium error remains.

    Returns (moisture, memory, gain), each (3, n): new = memory x old + ... + gain x equilibrium error. Under rain the
    target is saturation, and the equilibrium has no say. Unknown equilibrium or rain leaves the moisture as it was.
    """
    raining = rain_mm_h > RAIN_THRESHOLD_MM_H
    intensity = -np.expm1(-np.maximum(rain_mm_h - RAIN_THRESHOLD_MM_H, 0) / RAIN_SATURATING_MM_H)
    wet_memory = np.exp(-hours * intensity[None] / WETTING_LAG_H[:, None])
    dry_memory = np.exp(-hours / LAG_H)[:, None] * np.ones_like(wet_memory)
    memory = np.where(raining, wet_memory, dry_memory)
    target = np.where(raining, SATURATION_PCT, equilibrium_pct)[None]
    moved = target + (moisture_pct - target) * memory
    gain = np.where(raining, 0.0, 1 - dry_memory)
    unknown = np.isnan(moved)
    return np.where(unknown, moisture_pct, moved), np.where(unknown, 1.0, memory), np.where(unknown, 0.0, gain)


def run(
    hour: Array,
    equilibrium_pct: Array,
    rain_mm_h: Array,
    longitude_deg: Array,
    latitude_deg: Array,
    observations: StationObservations | None = None,
    noise: FilterNoise | None = None,
    initial: FilterState | None = None,
) -> FuelMoisture:
    """Filter ``n`` cells through ``t`` hours; without observations it is the plain model with its growing variance.

    ``hour`` (t,) hours from any origin, ascending, gaps allowed; ``equilibrium_pct`` and ``rain_mm_h`` (t, n), NaN
    where unknown; places (n,) in degrees. ``initial`` goes on from an earlier run that ended the hour before.
    """
    noise = noise or FilterNoise()
    count, cells = equilibrium_pct.shape
    accepted, refused = screened(observations, noise)
    begin = initial or first_state(equilibrium_pct, noise)
    state, covariance, probation = begin.mean.copy(), begin.covariance.copy(), dict(begin.probation)
    out, variance = np.full((count, 3, cells), np.nan), np.full((count, 3, cells), np.nan)
    used = 0
    for t in range(count):
        gap = hour[t] - hour[t - 1] if t else 1.0
        state, covariance = _predict(state, covariance, equilibrium_pct[t], rain_mm_h[t], gap, noise)
        for index in np.flatnonzero(accepted.hour == t) if accepted is not None else ():
            why = _heard(state, covariance, probation, accepted, int(index), (longitude_deg, latitude_deg), noise)
            used += not why
            if why:
                refused[why] = refused.get(why, 0) + 1
        out[t] = np.clip(state[:3], 0.5, SATURATION_PCT)
        variance[t] = np.diagonal(covariance, axis1=1, axis2=2)[:, :3].T
    unknown = np.isnan(equilibrium_pct)
    never = unknown.all(axis=0) if initial is None else np.zeros(cells, dtype=bool)
    out[:, :, never], variance[:, :, never] = np.nan, np.nan
    return FuelMoisture(out, variance, used, refused, unknown.sum(axis=0), FilterState(state, covariance, probation))


def _heard(
    state: Array,
    covariance: Array,
    probation: dict[tuple[float, float], int],
    observations: StationObservations,
    index: int,
    cells: tuple[Array, Array],
    noise: FilterNoise,
) -> str:
    """Hear one observation, in place; empty, or why it was refused. A station gone mad is on probation afterwards."""
    place = (float(observations.longitude_deg[index]), float(observations.latitude_deg[index]))
    owed = probation.get(place, 0)
    why = _update(state, covariance, observations, index, *cells, noise, owed > 0)
    probation[place] = noise.probation if why == BEYOND_GATE else max(owed - 1, 0)
    return why


def first_state(equilibrium_pct: Array, noise: FilterNoise) -> FilterState:
    """The start: every class in balance with the first day of the cell's air, variances of ``noise.initial``."""
    cells = equilibrium_pct.shape[1]
    state = np.zeros((4, cells))
    state[:3] = _first_day_mean(equilibrium_pct)
    return FilterState(state, np.tile(np.diag(noise.initial), (cells, 1, 1)))


def _first_day_mean(equilibrium_pct: Array) -> Array:
    """The start: every class in balance with the first day; the mean of all cells where a cell's day is unknown."""
    day = equilibrium_pct[:24]
    known = np.isfinite(day)
    mean = np.where(known, day, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.where(known.any(axis=0), mean, np.nanmean(equilibrium_pct))


def _predict(
    state: Array, covariance: Array, equilibrium_pct: Array, rain_mm_h: Array, gap_h: float, noise: FilterNoise
) -> tuple[Array, Array]:
    moved, memory, gain = step(state[:3], equilibrium_pct + state[3], np.nan_to_num(rain_mm_h), gap_h)
    bias_memory = np.exp(-gap_h / BIAS_MEMORY_H)
    cells = state.shape[1]
    transition = np.zeros((cells, 4, 4))
    for component in range(3):
        transition[:, component, component] = memory[component]
        transition[:, component, 3] = gain[component]
    transition[:, 3, 3] = bias_memory
    spread = transition @ covariance @ transition.transpose(0, 2, 1) + gap_h * np.diag(noise.process)
    return np.vstack([moved, state[3:] * bias_memory]), spread


def _update(
    state: Array,
    covariance: Array,
    observations: StationObservations,
    index: int,
    longitude_deg: Array,
    latitude_deg: Array,
    noise: FilterNoise,
    on_probation: bool,
) -> str:
    """Correct the cells in reach of one station, in place; says why not where it is refused at its own cell."""
    north = latitude_deg - observations.latitude_deg[index]
    east = (longitude_deg - observations.longitude_deg[index]) * np.cos(np.radians(observations.latitude_deg[index]))
    distance_km = 111.195 * np.hypot(north, east)
    near = np.flatnonzero(distance_km <= noise.reach_km)
    if not len(near):
        return "out of reach of every cell"
    error = observations.sd_pct[index] ** 2 + (noise.km_sd_pct * distance_km[near] / 10) ** 2
    innovation = observations.moisture_pct[index] - state[OBSERVED_CLASS, near]
    total = covariance[near, OBSERVED_CLASS, OBSERVED_CLASS] + error
    closest = int(np.argmin(distance_km[near]))
    if abs(innovation[closest]) > noise.gate * np.sqrt(total[closest]):
        return BEYOND_GATE
    if on_probation:
        return "on probation"
    gain = covariance[near][:, :, OBSERVED_CLASS] / total[:, None]
    state[:, near] += (gain * innovation[:, None]).T
    state[3, near] = np.clip(state[3, near], -BIAS_LIMIT_PCT, BIAS_LIMIT_PCT)
    covariance[near] -= gain[:, :, None] * covariance[near][:, OBSERVED_CLASS, None, :]
    return ""


def forecast(
    grid: WeatherGrid, observations: pd.DataFrame | None, time: pd.Timestamp, noise: FilterNoise | None = None
) -> FuelMoisture:
    """Fuel moisture of every hour of the grid: observations up to ``time`` correct it, after that it is a forecast.

    ``observations`` has time, geometry (points), fuel_moisture_10h_pct and optionally fuel_moisture_sd_pct. The cells
    of the result run over (latitude, longitude) in C order.
    """
    noise = noise or FilterNoise()
    if not len(grid.time):
        raise DomainError("The weather grid holds no hour.", field="weather", accepted="at least one hour")
    cells = (len(grid.time), -1)
    equilibrium = indices.equilibrium_moisture_pct(
        grid.fields["temperature_c"], grid.fields["relative_humidity_pct"]
    ).reshape(cells)
    latitude, longitude = np.meshgrid(grid.latitude_deg, grid.longitude_deg, indexing="ij")
    hour = (grid.time - grid.time[0]) / np.timedelta64(1, "h")
    stations, unused = (None, {}) if observations is None else at_hours(observations, grid, time, noise)
    rain = grid.fields["rain_mm"].reshape(cells)
    result = run(hour, equilibrium, rain, longitude.ravel(), latitude.ravel(), stations, noise)
    return replace(result, refused=unused | result.refused)
