"""Where the fire may arrive within the next 24 hours: the front of an arrival map carried forward by fast marching.

The speed at a place is the last day's displacement of the nearest front, by direction; with weather, scaled and turned
by what wind and moisture change. Fast marching (`eikonalfm`) carries it forward for several headings; the spread of
the rate is lognormal. Constants were chosen on the tuning seeds of the synthetic fires.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, label
from scipy.stats import norm

from services.arrival.front.rates import DAY_H, FrontRates, front_rates
from services.arrival.front.weather import HourlyWeather, run_by_direction
from services.arrival.inference import ArrivalMap

# A day's growth is seldom repeated whole: fuel ends, crews work; and headings that scatter blunt the mean head, which
# SWING makes good.
REPEAT, SWING = 0.8, 1.3
HEADINGS = np.linspace(-2.0, 2.0, 7)
TURN_SD_RAD, RATE_SD = 0.8, 0.63
LOCAL_WEIGHT, LOCAL_REACH_KM = 0.5, 1.0
# Where the front's motion is unknown (one detection, one pass): a wildfire's daily run in general, km, widely spread.
UNKNOWN_RUN_KM, UNKNOWN_SD = 1.0, 1.2
UNKNOWN_FLAGS = frozenset({"one-detection", "one-instant", "burned-area-only"})
INSIDE_KM_H, SLOWEST_KM_H, MOST_PARTS = 1e4, 1e-4, 8
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Front:
    """Probability (rows, columns) that the fire arrives within the 24 h after the end where it had not by then;
    `basis` names what it rests on: `spread`, `spread+weather`, `climatology` or `none`."""

    probability: Floats
    basis: str

    def burned_by_then(self, arrival: ArrivalMap) -> Mask:
        """Cells burned 24 h after the end, more likely than not."""
        return np.isfinite(arrival.arrival_h) | (self.probability >= 0.5)


def march(burned: Mask, speed_km_h: Floats, cell_km: float) -> Floats:
    """Hours until a front that starts at the edge of `burned` arrives (0 inside), by first-order fast marching.

    Every connected part of the burned area is a source of its own (the largest eight); the edge lies half a cell out.
    """
    import eikonalfm

    parts, count = label(burned)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
    hours = np.full(burned.shape, np.inf)
    for part in np.argsort(-sizes, kind="stable")[:MOST_PARTS] + 1:
        inside = np.argwhere(parts == part)
        speed = np.where(parts == part, INSIDE_KM_H, np.maximum(speed_km_h, SLOWEST_KM_H))
        source = tuple(int(i) for i in inside[len(inside) // 2])
        hours = np.minimum(hours, eikonalfm.fast_marching(speed, source, (cell_km, cell_km), 1))
    hours = np.maximum(hours - 0.5 * cell_km / np.maximum(speed_km_h, SLOWEST_KM_H), 1e-3)
    return np.where(burned, 0.0, hours)


def _directions(burned: Mask) -> tuple[Floats, Floats]:
    """Angle (radians from east) at which the front comes to each cell, smoothed, and distance to it in cells."""
    distance, nearest = distance_transform_edt(~burned, return_indices=True)
    row, column = np.indices(burned.shape)
    safe = np.maximum(distance, 1.0)
    north = gaussian_filter((row - nearest[0]) / safe, 1.5)
    east = gaussian_filter((column - nearest[1]) / safe, 1.5)
    return np.arctan2(north, east), distance


def _weather_ratio(weather: HourlyWeather | None, rates: FrontRates, end_h: float) -> tuple[Floats, Floats] | None:
    """The coming day's run by direction over the mean run of the last window, at 72 angles; None without both."""
    if weather is None:
        return None
    past, coming = weather.between(end_h - rates.window_h, end_h), weather.between(end_h, end_h + DAY_H)
    if len(past) < 3 or len(coming) < 12:
        return None
    angles = np.linspace(-np.pi, np.pi, 73)
    before = run_by_direction(past, angles)
    return angles, run_by_direction(coming, angles) / max(float(before[:-1].mean()), 1e-6)


def _chances(burned: Mask, speeds: list[Floats], rate_sd: float, cell_km: float) -> Floats:
    """Probability of arrival within a day: headings weighted as a normal, the rate lognormal around each speed."""
    weights = norm.pdf(HEADINGS) if len(speeds) > 1 else np.ones(1)
    total = np.zeros(burned.shape)
    for weight, speed in zip(weights / weights.sum(), speeds, strict=True):
        hours = march(burned, speed, cell_km)
        with np.errstate(divide="ignore"):
            total += weight * norm.cdf(np.log(DAY_H / hours) / rate_sd)
    return total


def forecast_front(arrival: ArrivalMap, end_h: float, weather: HourlyWeather | None = None) -> Front:
    """The next 24 h of a map whose period ended at `end_h` (hours since its reference time)."""
    burned = np.isfinite(arrival.arrival_h)
    cell_km = arrival.grid.cell_m / 1e3
    if not burned.any():
        return Front(np.zeros(burned.shape), "none")
    if UNKNOWN_FLAGS & set(arrival.flags) or min(burned.shape) < 3:
        speed = np.full(burned.shape, UNKNOWN_RUN_KM / DAY_H)
        return Front(_new_only(burned, _chances(burned, [speed], UNKNOWN_SD, cell_km)), "climatology")
    rates = front_rates(arrival.arrival_h, end_h, cell_km)
    angle, distance = _directions(burned)
    expected = np.maximum(rates.towards(angle), 1e-3)
    relative = np.clip(np.maximum(rates.local_km, 0.05 * rates.mean_km) / expected, 0.2, 5.0)
    local = relative ** (LOCAL_WEIGHT * np.exp(-distance * cell_km / LOCAL_REACH_KM))
    ratio = _weather_ratio(weather, rates, end_h)
    speeds = []
    for turn in HEADINGS * TURN_SD_RAD * (0.5 if ratio else 1.0):
        if ratio is None:
            run = rates.towards(angle, turn, swing=SWING) * local
        else:
            turned = (angle - turn + np.pi) % (2 * np.pi) - np.pi
            run = rates.mean_km * np.interp(turned, *ratio) * np.sqrt(local)
        speeds.append(REPEAT * run / rates.window_h)
    return Front(_new_only(burned, _chances(burned, speeds, RATE_SD, cell_km)), "spread+weather" if ratio else "spread")


def _new_only(burned: Mask, probability: Floats) -> Floats:
    """The probability of a new arrival: none where the fire has been."""
    return np.where(burned, 0.0, np.clip(probability, 0.0, 1.0))


def persistence(arrival: ArrivalMap) -> Mask:
    """The plain forecast that nothing more burns: cells burned by the end."""
    return np.isfinite(arrival.arrival_h)


def constant_rate(arrival: ArrivalMap, end_h: float) -> Mask:
    """The plain forecast that the whole outline moves on as far as the last day moved it (in equivalent radius)."""
    burned = np.isfinite(arrival.arrival_h)
    if not burned.any():
        return burned
    before = burned & (arrival.arrival_h <= end_h - DAY_H)
    cell_km = arrival.grid.cell_m / 1e3
    radius = [np.sqrt(mask.sum() / np.pi) * cell_km for mask in (burned, before)]
    distance = distance_transform_edt(~burned) * cell_km
    return np.asarray(distance <= radius[0] - radius[1])
