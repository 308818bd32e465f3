"""Time scales of orbit files to UTC, with the leap seconds that astropy-iers-data ships."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TT_MINUS_TAI_S = 32.184
GPS_MINUS_TAI_S = -19.0
BDT_MINUS_TAI_S = -33.0
# TDB differs from TT by less than 2 ms (15 m of a low orbit's way); the clocks of Galileo, QZSS and GPS by nanoseconds.
SCALE_MINUS_TAI_S = {
    "TAI": 0.0,
    "TT": TT_MINUS_TAI_S,
    "TDT": TT_MINUS_TAI_S,
    "TDB": TT_MINUS_TAI_S,
    "GPS": GPS_MINUS_TAI_S,
    "GAL": GPS_MINUS_TAI_S,
    "QZS": GPS_MINUS_TAI_S,
    "BDT": BDT_MINUS_TAI_S,
}
SCALES = ("UTC", *SCALE_MINUS_TAI_S)

_MICROSECOND = np.timedelta64(1, "us")


def tai_minus_utc_s(when: datetime) -> float:
    """Leap seconds: TAI - UTC (s) at a UTC time; before 1972 as on that day, beyond the table as at its end."""
    return float(_offsets_at(np.array([when.astimezone(UTC).replace(tzinfo=None)], dtype="datetime64[us]"))[0])


def to_utc(times: NDArray[np.datetime64], scale: str) -> NDArray[np.datetime64]:
    """Times (n,) read in one of ``SCALES`` as UTC, datetime64[us]; KeyError for another scale.

    The offset is looked up at the scale's own reading, which differs from UTC by a minute and a half at most.
    """
    times = times.astype("datetime64[us]")
    if scale == "UTC":
        return times
    behind_tai = SCALE_MINUS_TAI_S[scale]
    about = times - np.round((37.0 + behind_tai) * 1e6).astype(np.int64) * _MICROSECOND
    seconds = behind_tai + _offsets_at(about)
    return np.asarray(times - np.round(seconds * 1e6).astype(np.int64) * _MICROSECOND)


def _offsets_at(utc: NDArray[np.datetime64]) -> NDArray[np.float64]:
    days, offsets = _leap_seconds()
    return offsets[np.clip(np.searchsorted(days, utc, side="right") - 1, 0, len(days) - 1)]


@cache
def _leap_seconds() -> tuple[NDArray[np.datetime64], NDArray[np.float64]]:
    """Days on which an offset begins, and the offsets (s), from IERS' Leap_Second.dat."""
    import astropy_iers_data

    lines = Path(astropy_iers_data.IERS_LEAP_SECOND_FILE).read_text(encoding="ascii").splitlines()
    rows = [line.split() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    days = [f"{int(year):04d}-{int(month):02d}-{int(day):02d}" for _, day, month, year, _ in rows]
    return np.array(days, dtype="datetime64[us]"), np.array([float(row[4]) for row in rows])
