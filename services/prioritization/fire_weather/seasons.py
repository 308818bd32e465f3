"""The Canadian indices over years at one place: fire seasons by temperature, drought code carried over winter."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization import indices
from services.prioritization.physical_ranges import physical
from shared.errors import DomainError

if TYPE_CHECKING:
    from climate_indices.fire import CFFWISState

Array = npt.NDArray[np.float64]

START_ABOVE_C = 12.0
END_BELOW_C = 5.0
DAYS_IN_A_ROW = 3
BRIDGED_DAYS = 7
FFMC_START, DMC_START, DC_START = 85.0, 6.0, 15.0
NAMES = ("ffmc", "dmc", "dc", "isi", "bui", "fwi")


@dataclass(frozen=True)
class Carried:
    """What a later run resumes from: the day before it, whether in season, codes there, and rain since the season."""

    in_season: bool
    state: CFFWISState | None
    last_dc: float
    winter_rain_mm: float
    recent_maxima_c: tuple[float, ...]


def fire_season(temperature_max_c: npt.ArrayLike, in_season: bool = False) -> npt.NDArray[np.bool_]:
    """Days (t,) in the fire season: it opens after 3 days above 12 degC and closes after 3 days below 5 degC.

    Wotton & Flannigan 1993, as in cffdrs ``fireSeason``. A missing day breaks a row of days.
    """
    warmest = physical(temperature_max_c, "temperature_c")
    out = np.zeros(len(warmest), dtype=bool)
    open_now, row = in_season, 0
    for day, value in enumerate(warmest):
        row = row + 1 if (value < END_BELOW_C if open_now else value > START_ABOVE_C) else 0
        if row == DAYS_IN_A_ROW:
            open_now, row = not open_now, 0
        out[day] = open_now
    return out


def canadian_years(
    weather: pd.DataFrame, latitude_deg: float, resume: Carried | None = None, carry_over: float = 0.75
) -> tuple[pd.DataFrame, Carried]:
    """Codes and indices of each day (columns ``NAMES``), NaN outside the fire season, and what to resume from.

    ``weather`` is indexed by day without gaps: temperature_c, relative_humidity_pct, wind_speed_m_s (noon), rain_mm (24
    h), temperature_max_c. A season starts from FFMC 85, DMC 6 and the DC that last autumn's became over the winter's
    rain (Lawson & Armitage 2008); the first one ever from 15. A missing day is NaN, and up to 7 in a row do not end the
    season's series; winter starts from the last DC known. DomainError names a missing column or a day left out.
    """
    _check(weather)
    before = resume or Carried(False, None, np.nan, 0.0, ())
    warmest = np.append(before.recent_maxima_c, weather["temperature_max_c"].to_numpy(dtype=np.float64))
    season = fire_season(warmest, before.in_season)[len(before.recent_maxima_c) :]
    out = pd.DataFrame(np.nan, index=weather.index, columns=list(NAMES))
    state, last_dc, winter_rain = before.state, before.last_dc, before.winter_rain_mm
    for begin, end in _stretches(season):
        part = weather.iloc[begin:end]
        if not season[begin]:
            state, winter_rain = None, winter_rain + float(np.nansum(part["rain_mm"]))
            continue
        dc = DC_START
        if state is None and not np.isnan(last_dc):
            dc = float(indices.overwintered_dc(last_dc, winter_rain, carry_over))
        result = indices.canadian(
            *(part[name] for name in ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "rain_mm")),
            latitude_deg=latitude_deg,
            month=part.index.month.to_numpy(),
            state=state,
            start=(FFMC_START, DMC_START, dc),
            bridged_days=BRIDGED_DAYS,
        )
        for name in NAMES:
            out.iloc[begin:end, out.columns.get_loc(name)] = getattr(result, name).ravel()
        known = result.dc[np.isfinite(result.dc)]
        state, last_dc, winter_rain = result.state, float(known[-1]) if len(known) else last_dc, 0.0
    in_season = bool(season[-1])
    return out, Carried(in_season, state, last_dc, winter_rain, _pending(warmest, in_season))


def _check(weather: pd.DataFrame) -> None:
    needed = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "rain_mm", "temperature_max_c")
    for name in needed:
        if name not in weather.columns:
            raise DomainError(f"The weather lacks '{name}'.", field=name, accepted=", ".join(needed))
    steps = np.diff(weather.index.to_numpy())
    if len(weather) == 0 or (steps != np.timedelta64(1, "D")).any():
        row = int(np.argmax(steps != np.timedelta64(1, "D"))) if len(steps) else 0
        raise DomainError(
            "The days do not follow one another.",
            field="weather",
            value=str(weather.index[row]) if len(weather) else "no day",
            accepted="one row a day, missing values as NaN",
        )


def _stretches(season: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = [0, *(np.flatnonzero(np.diff(season)) + 1), len(season)]
    return [(int(begin), int(end)) for begin, end in pairwise(edges)]


def _pending(warmest: Array, in_season: bool) -> tuple[float, ...]:
    """The last days that already count towards the next opening or closing, so that a later run goes on counting."""
    row: list[float] = []
    for value in warmest[::-1][: DAYS_IN_A_ROW - 1]:
        if not (value < END_BELOW_C if in_season else value > START_ABOVE_C):
            break
        row.append(float(value))
    return tuple(reversed(row))
