"""What weather can be: values outside are missing, and an array with too many of them has the wrong unit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.errors import DomainError

Array = npt.NDArray[np.float64]

REFUSED_SHARE = 0.01
RANGES: dict[str, tuple[float, float, str]] = {
    "temperature_c": (-100.0, 60.0, "degC"),
    "dew_point_c": (-120.0, 40.0, "degC"),
    "relative_humidity_pct": (0.0, 105.0, "%"),
    "wind_speed_m_s": (0.0, 120.0, "m/s"),
    "rain_mm": (-0.01, 2000.0, "mm per day"),
    "annual_rain_mm": (0.0, 15000.0, "mm per year"),
    "kbdi_mm": (0.0, 203.2001, "mm"),
    "height_agl_m": (-12000.0, 60000.0, "m"),
    "latitude_deg": (-90.0, 90.0, "degrees"),
}
"""Wide enough for any level of the atmosphere that an index reads; surface grids have their own, narrower ones."""


def physical(values: npt.ArrayLike, name: str) -> Array:
    """The values as float64, impossible ones replaced by NaN; humidity just above 100 % counts as 100 %.

    DomainError naming the input where more than one in a hundred of the known values is impossible: then its unit is
    wrong (kelvin, fractions, a 300 degC day), and no danger may come of it.
    """
    array = np.asarray(values, dtype=np.float64)
    low, high, unit = RANGES[name]
    least = np.fmin.reduce(array, axis=None, initial=np.inf)
    most = np.fmax.reduce(array, axis=None, initial=-np.inf)
    if least < low or most > high:
        bad = (array < low) | (array > high)
        known, count = int(np.isfinite(array).sum()), int(bad.sum())
        if count > REFUSED_SHARE * known:
            worst = float(array[bad].ravel()[np.argmax(np.abs(array[bad]))])
            raise DomainError(
                f"'{name}': {count} of {known} values lie outside {low:g}..{high:g} {unit} (such as {worst:g}); the "
                "unit is probably wrong.",
                field=name,
                value=worst,
                accepted=f"{low:g}..{high:g} {unit}",
            )
        array = np.where(bad, np.nan, array)
    if name == "relative_humidity_pct" and most > 100:
        array = np.minimum(array, 100.0)
    return array
