"""Five years of dead fuel moisture: the filter against the model alone, on a synthetic truth under real weather.

The weather is that of one RAWS station, hourly 2012-2016, holes and all. The truth is SYNTHETIC (nobody measured fuel
moisture there): a fuel of other time lags, another equilibrium that drifts with the season, and other wetting. From it
come the observations of a 10-h sensor: noisy, two hours in three missing, silent for weeks three times a year, mad for
days five times a year. Once a day a forecast of 48 h starts from what was known, with the weather as it came (so the
error is the moisture's, not the weather's).

``python -m tests.bench.prioritization.fuel_moisture_trial FIGURE.png`` draws it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization import fuel_moisture, indices
from services.prioritization.fuel_moisture_stations import StationObservations

Array = npt.NDArray[np.float64]
Metric = tuple[str, float, str, float | None]

AHEAD_H = 48
NOISE_SD_PCT = 1.5
TRUE_LAG_H = np.array([1.6, 13.0, 140.0])
TRUE_WETTING_LAG_H = np.array([2.0, 18.0, 170.0])
HERE = np.array([0.0])


@dataclass(frozen=True)
class Weather:
    """Hourly weather on a gapless axis (t,): equilibrium moisture in per cent, rain in mm; NaN in the holes."""

    time: pd.DatetimeIndex
    equilibrium_pct: Array
    rain_mm: Array


def read_station(path: Path) -> Weather:
    """The RAWS file with inches and degrees Fahrenheit turned into SI; hours that are missing become NaN."""
    table = pd.read_csv(path)
    table.columns = [name.strip() for name in table.columns]
    hours = pd.to_datetime(table["DATE"].str.strip()) + pd.to_timedelta(table["Time"].astype(int) // 100, unit="h")
    table = table.assign(hours=hours).drop_duplicates("hours").set_index("hours").sort_index()
    axis = pd.date_range(table.index[0], table.index[-1], freq="h")
    table = table.reindex(axis)
    temperature = (table["Temp"].to_numpy(dtype=float) - 32) / 1.8
    humidity = np.clip(table["RH"].to_numpy(dtype=float), 0, 100)
    # HrRa is the hour's rain; the column Rain repeats a day's total at each of its hours.
    return Weather(axis, indices.equilibrium_moisture_pct(temperature, humidity), 25.4 * table["HrRa"].to_numpy(float))


def truth(weather: Weather) -> Array:
    """Moisture (t, 3) of another fuel: slower, 1.15 times the equilibrium plus 1 to 3 % by season, wetting at 5 mm/h.

    In the holes of the weather the truth goes on under the last known air.
    """
    day = weather.time.dayofyear.to_numpy()
    target = 1.15 * pd.Series(weather.equilibrium_pct).ffill().to_numpy() + 2 + np.cos(2 * np.pi * day / 365.25)
    rain = np.nan_to_num(weather.rain_mm)
    out, value = np.empty((len(day), 3)), np.full(3, target[:24].mean())
    for t in range(len(day)):
        if rain[t] > 0.02:
            rate = -np.expm1(-rain[t] / 5.0) / TRUE_WETTING_LAG_H
            value = 220 + (value - 220) * np.exp(-rate)
        else:
            value = target[t] + (value - target[t]) * np.exp(-1 / TRUE_LAG_H)
        out[t] = value
    return out


def sensor(moisture_10h: Array, seed: int = 0) -> tuple[Array, npt.NDArray[np.bool_]]:
    """What a 10-h sensor reports (t,), NaN where silent, and where it is mad (stuck, jumping or impossible)."""
    rng = np.random.default_rng(seed)
    count = len(moisture_10h)
    seen = moisture_10h + rng.normal(0, NOISE_SD_PCT, count)
    mad = np.zeros(count, dtype=bool)
    for begin in rng.integers(0, count - 400, 5 * count // 8760):
        spell = slice(begin, begin + int(rng.integers(24, 120)))
        mad[spell] = True
        length = len(seen[spell])
        kind = rng.integers(3)
        seen[spell] = (np.full(length, 40.0), seen[spell] + rng.normal(0, 40, length), np.full(length, 999.0))[kind]
    for begin in rng.integers(0, count - 1000, 3 * count // 8760):
        seen[begin : begin + int(rng.integers(100, 900))] = np.nan
    seen[rng.random(count) < 2 / 3] = np.nan
    return seen, mad & np.isfinite(seen)


@dataclass(frozen=True)
class Trial:
    """Errors in per cent moisture of the 10-h class: analyses (t,), forecasts (days, 48), and the stated sds of both.

    ``plain`` is the model without the filter at the same hours.
    """

    time: pd.DatetimeIndex
    truth: Array
    observed: Array
    plain: Array
    filtered: Array
    filtered_sd: Array
    lead_plain: Array
    lead_error: Array
    lead_sd: Array
    refused: dict[str, int]
    used: int
    mad: npt.NDArray[np.bool_]


def run(weather: Weather, seed: int = 0) -> Trial:
    """Filter day by day, each day resuming from the one before; from each day's end 48 h of forecast."""
    moisture = truth(weather)
    observed, mad = sensor(moisture[:, 1], seed)
    equilibrium, rain = weather.equilibrium_pct[:, None], weather.rain_mm[:, None]
    hour = np.arange(len(equilibrium), dtype=float)
    kept = np.flatnonzero(np.isfinite(observed))
    zeros = np.zeros(len(kept))
    stations = StationObservations(kept, zeros, zeros, observed[kept], np.full(len(kept), NOISE_SD_PCT))
    plain = fuel_moisture.run(hour, equilibrium, rain, HERE, HERE)
    filtered = fuel_moisture.run(hour, equilibrium, rain, HERE, HERE, stations)
    starts = np.arange(24 * 10, len(hour) - AHEAD_H, 24)
    states = _states_at(hour, equilibrium, rain, stations, starts)
    ahead = starts[None, :] + np.arange(1, AHEAD_H + 1)[:, None]
    places = np.zeros(len(starts))
    forecast = fuel_moisture.run(
        np.arange(AHEAD_H, dtype=float), equilibrium[ahead, 0], rain[ahead, 0], places, places, initial=states
    )
    return Trial(
        weather.time,
        moisture[:, 1],
        observed,
        plain.moisture_pct[:, 1, 0],
        filtered.moisture_pct[:, 1, 0],
        np.sqrt(filtered.variance[:, 1, 0]),
        (plain.moisture_pct[ahead, 1, 0] - moisture[ahead, 1]).T,
        (forecast.moisture_pct[:, 1] - moisture[ahead, 1]).T,
        np.sqrt(forecast.variance[:, 1]).T,
        filtered.refused,
        filtered.used,
        mad,
    )


def _states_at(
    hour: Array, equilibrium: Array, rain: Array, stations: StationObservations, starts: npt.NDArray[np.int64]
) -> fuel_moisture.FilterState:
    """The filter's state after each of ``starts``, as cells side by side."""
    states, state, begin = [], None, 0
    for start in starts:
        span = slice(begin, int(start) + 1)
        inside = (stations.hour >= begin) & (stations.hour <= start)
        part = StationObservations(
            stations.hour[inside] - begin,
            *(
                v[inside]
                for v in (stations.longitude_deg, stations.latitude_deg, stations.moisture_pct, stations.sd_pct)
            ),
        )
        state = fuel_moisture.run(hour[span], equilibrium[span], rain[span], HERE, HERE, part, initial=state).state
        states.append(state)
        begin = int(start) + 1
    return fuel_moisture.FilterState(
        np.concatenate([s.mean for s in states], axis=1), np.concatenate([s.covariance for s in states])
    )


def rmse(error: Array) -> float:
    """Root mean square of an error, per cent moisture."""
    return float(np.sqrt(np.mean(error**2)))


def metrics(trial: Trial) -> Iterator[Metric]:
    """The trial's figures; dry hours are those whose true moisture is below 30 %, where fires run."""
    dry = trial.truth < 30
    error, plain = trial.filtered - trial.truth, trial.plain - trial.truth
    yield "fuel_moisture_rmse_pct", rmse(error[dry]), "%", None
    yield "fuel_moisture_rmse_without_filter_pct", rmse(plain[dry]), "%", None
    within = np.abs(error[dry]) <= 1.645 * trial.filtered_sd[dry]
    yield "fuel_moisture_covered_by_90_pct_interval", 100 * float(within.mean()), "%", None
    # Sound hours and those up to six hours after a mad value, told apart by the maker of the sensor alone.
    shaken = dry & (pd.Series(trial.mad).rolling(6, min_periods=1).max().to_numpy() > 0)
    yield "fuel_moisture_rmse_station_mad_pct", rmse(error[shaken]), "%", None
    yield "fuel_moisture_rmse_station_mad_without_filter_pct", rmse(plain[shaken]), "%", None
    # Whether a forecast hour counts is the truth's matter alone, never the forecast's.
    starts = np.arange(24 * 10, len(trial.truth) - AHEAD_H, 24)
    dry_ahead = dry[starts[:, None] + np.arange(1, AHEAD_H + 1)]
    for lead in (24, 48):
        chosen = dry_ahead[:, lead - 1]
        yield f"fuel_moisture_rmse_{lead}h_pct", rmse(trial.lead_error[chosen, lead - 1]), "%", None
        yield f"fuel_moisture_rmse_{lead}h_without_filter_pct", rmse(trial.lead_plain[chosen, lead - 1]), "%", None
    covered = np.abs(trial.lead_error) <= 1.645 * trial.lead_sd
    yield (
        "fuel_moisture_48h_covered_by_90_pct_interval",
        100 * float(covered[:, -1][dry_ahead[:, -1]].mean()),
        "%",
        None,
    )


def draw(trial: Trial, path: Path) -> None:
    """A dry month with truth, sensor, model and filter, and the error by hours ahead."""
    from matplotlib.figure import Figure

    from shared import figures
    from shared.versions import code_version

    figure = Figure(figsize=(11, 6.5), layout="constrained")
    figure.get_layout_engine().set(rect=(0, 0.03, 1, 0.94))
    month, lead = figure.subplots(2, 1, height_ratios=(1.5, 1))
    part = slice(*np.searchsorted(trial.time, [pd.Timestamp("2013-06-20"), pd.Timestamp("2013-07-20")]))
    t = trial.time[part]
    band = 1.645 * trial.filtered_sd[part]
    month.fill_between(t, trial.filtered[part] - band, trial.filtered[part] + band, color="#9ecae1", label="90 %")
    month.plot(t, trial.observed[part], ".", color="0.6", markersize=3, label="sensor (synthetic)")
    month.plot(t, trial.plain[part], color="#fd8d3c", linewidth=1, label="model without filter")
    month.plot(t, trial.filtered[part], color="#08519c", linewidth=1, label="filter")
    month.plot(t, trial.truth[part], color="black", linewidth=1, linestyle="--", label="truth (synthetic)")
    month.set(ylabel="10-h moisture, %", ylim=(0, 22))
    month.legend(fontsize=8, ncol=5, loc="upper left")
    month.tick_params(axis="x", labelsize=8)
    hours = np.arange(1, AHEAD_H + 1)
    lead.plot(hours, [rmse(trial.lead_plain[:, i]) for i in range(AHEAD_H)], color="#fd8d3c", label="without filter")
    lead.plot(hours, [rmse(trial.lead_error[:, i]) for i in range(AHEAD_H)], color="#08519c", label="filter")
    lead.set(xlabel="hours ahead", ylabel="RMSE, %", ylim=(0, None), xlim=(1, AHEAD_H))
    lead.legend(fontsize=8)
    figure.suptitle("Dead fuel moisture under five years of real weather, SYNTHETIC truth and sensor", fontsize=11)
    code = code_version(Path(fuel_moisture.__file__).parent)
    stated = {"simulated": True, "simulated_share": 0.5, "oldest_input": "2012-01-01", "code_version": code}
    figures.save(figure, path, stated)


if __name__ == "__main__":
    station = read_station(Path(os.environ["SMOKEGLINT_DATA"]) / "weather" / "raws_260402_hourly_2012_2016.csv.gz")
    result = run(station)
    for name, value, unit, _ in metrics(result):
        print(f"{name} {value:.3f} {unit}")
    print(result.used, int(result.mad.sum()), result.refused)
    draw(result, Path(sys.argv[1]))
