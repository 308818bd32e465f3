"""Fires to learn from: no constant of the synthetic fires is kept, every one is drawn anew for every fire.

What is learned has to hold for fires that another generator or nature makes. So the way of spreading, the hours of the
day at which it runs, size (a kilometre to tens of them), length, fuel, the hours a place burns, detection, passes,
pixel sizes and thinning all vary; some fires stop long before the end, some start in two places.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from tests.services.arrival.seeds import TRAINING_SMALL
from tests.services.arrival.synthetic_fires import (
    CELL_KM,
    SIDE_KM,
    STEP_H,
    Place,
    SyntheticFire,
    Viewing,
    observed,
    run_by_direction,
    smooth_noise,
    spread,
)

SATELLITES = (("SUOMI NPP",), ("NOAA 20",), ("SUOMI NPP", "NOAA 20"), ("AQUA", "TERRA"))


def _daily_rate(rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
    """Relative speed of the fire at `times`: by day and hour, with a phase of its own; mean about one half."""
    phase, power, night = rng.uniform(0, 24), rng.uniform(0.5, 3.0), np.exp(rng.uniform(np.log(0.03), np.log(0.7)))
    rate = night + np.clip(np.sin(2 * np.pi * (times - phase) / 24), 0, None) ** power
    day = np.floor((times - phase) / 24).astype(int)
    rate *= np.exp(rng.uniform(0.0, 0.6) * rng.standard_normal(day.max() - day.min() + 1))[day - day.min()]
    return np.asarray(rate * np.exp(rng.uniform(0.0, 0.4) * _walk(rng, times.size, rng.uniform(4, 24))))


def _walk(rng: np.random.Generator, count: int, sigma: float) -> np.ndarray:
    values = gaussian_filter(rng.standard_normal(count), sigma, mode="wrap")
    return np.asarray(values / max(values.std(), 1e-9))


def _progress(rng: np.random.Generator, hours: float, size: int) -> list[list[float]]:
    """Kilometres run in each direction by each quarter hour, with a wind that turns a little or much."""
    times = np.arange(0.0, hours + STEP_H, STEP_H)
    wind = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 1, times.size)) * rng.uniform(0.02, 0.2)
    wind = gaussian_filter(wind, rng.uniform(4, 24))
    eccentricity = np.clip(rng.uniform(0.0, 0.85) + rng.uniform(0.0, 0.2) * _walk(rng, times.size, 24), 0.0, 0.93)
    head_km_h = np.exp(rng.uniform(np.log(0.1), np.log(0.5))) * _daily_rate(rng, times)
    return run_by_direction(head_km_h, wind, eccentricity)


def _fuel(rng: np.random.Generator, size: int) -> np.ndarray:
    fuel = np.exp(rng.uniform(0.1, 0.8) * smooth_noise(rng, size, np.exp(rng.uniform(np.log(2), np.log(12)))))
    fuel[smooth_noise(rng, size, rng.uniform(2, 8)) > rng.uniform(1.3, 3.0)] = 0.0
    if rng.random() < 0.2:  # a road or a river
        angle, offset = rng.uniform(0, np.pi), rng.uniform(-0.3, 0.3) * size
        row, column = np.mgrid[:size, :size] - size / 2
        fuel[np.abs(row * np.sin(angle) + column * np.cos(angle) - offset) < rng.uniform(0.5, 1.2)] *= 0.1
    return np.asarray(fuel * np.exp(rng.uniform(-0.5, 0.5)))


def _start(rng: np.random.Generator, size: int) -> tuple[int, int]:
    return int(rng.uniform(0.3, 0.7) * size), int(rng.uniform(0.3, 0.7) * size)


def _by_wind(rng: np.random.Generator, fuel: np.ndarray, start: tuple[int, int], hours: float) -> np.ndarray:
    """A fire that runs along a changing wind."""
    return spread(fuel, start, _progress(rng, hours, fuel.shape[0]), hours)


def _by_pace(rng: np.random.Generator, fuel: np.ndarray, start: tuple[int, int], hours: float) -> np.ndarray:
    """A fire with a pace of its own at every place, whatever the direction, slowed and sped up by one clock for all."""
    from eikonalfm import fast_marching

    size = fuel.shape[0]
    row, column = (np.mgrid[:size, :size] - np.array(start)[:, None, None]) / size
    slope = rng.uniform(0.0, 3.0) * (row * np.sin(a := rng.uniform(0, 2 * np.pi)) + column * np.cos(a))
    speed = np.maximum(fuel, 1e-4) * np.exp(np.clip(slope, -2, 2))
    steady = np.asarray(fast_marching(speed, start, (1.0, 1.0), 1))
    times = np.arange(0.0, hours + STEP_H, STEP_H)
    grown = np.concatenate([[0.0], np.cumsum(_daily_rate(rng, times))[:-1]])
    reached = np.quantile(steady[fuel > 0], np.exp(rng.uniform(np.log(0.005), np.log(0.45))))
    arrival = np.interp(steady / reached * grown[-1], grown, times, right=np.inf)
    return np.where((arrival <= hours) & (fuel > 0), arrival, np.nan)


def _viewing(rng: np.random.Generator) -> Viewing:
    centre = float(rng.uniform(0.35, 0.9))
    detect = {"VIIRS": centre, "MODIS": float(np.clip(centre * rng.uniform(0.5, 1.1), 0.2, 0.9))}
    return Viewing(
        float(np.exp(rng.uniform(np.log(3.0), np.log(20.0)))),
        detect,
        float(rng.uniform(0.3, 1.0)) if rng.random() < 0.4 else 1.0,
        SATELLITES[rng.integers(len(SATELLITES))] if rng.random() < 0.2 else (),
        float(rng.uniform(1.0, 2.0)) if rng.random() < 0.4 else 1.0,
        int(rng.integers(2**31)),
        float(rng.uniform(0.0, 0.95)),
        float(rng.uniform(0.0, 0.35)),
    )


def training_fire(seed: int) -> tuple[SyntheticFire, float]:
    """A fire and the share of the usual square's side that it fills; the same seed gives the same fire. Seeds of
    `TRAINING_SMALL` give small fires of one to three days, seen in every pixel."""
    rng = np.random.default_rng(seed)
    size = int(SIDE_KM / CELL_KM)
    if seed in TRAINING_SMALL:
        share, days = float(np.exp(rng.uniform(np.log(0.1), np.log(0.6)))), int(rng.integers(1, 4))
    else:
        share = 1.0 if rng.random() < 0.6 else float(np.exp(rng.uniform(np.log(0.12), np.log(1.3))))
        days = 5 if rng.random() < 0.5 else int(rng.integers(1, 7))
    hours = days * 24.0
    fuel = _fuel(rng, size)
    grow = _by_pace if rng.random() < 0.3 else _by_wind
    first = _start(rng, size)
    fuel[first] = 1.0
    arrival_h = grow(rng, fuel, first, hours)
    if rng.random() < 0.1:  # a second fire that the first one meets or not
        second = _start(rng, size)
        fuel[second] = 1.0
        later = rng.uniform(0.0, 0.4) * hours
        other = grow(rng, fuel, second, hours) + later
        arrival_h = np.fmin(arrival_h, np.where(other <= hours, other, np.nan))
    if rng.random() < 0.25:
        arrival_h = np.where(arrival_h <= hours * rng.uniform(0.3, 1.0), arrival_h, np.nan)
    looks = None if seed in TRAINING_SMALL else (20_000, 20_000, 3_000, 60_000, None)[rng.integers(5)]
    place, view = Place(13, (400_000.0, 3_700_000.0)), _viewing(rng)
    cloud = float(rng.uniform(0.0, 0.6))
    fire = observed(seed, rng, arrival_h, CELL_KM * share, first, days, looks, 0, cloud, place, 24.0, viewing=view)
    return fire, share
