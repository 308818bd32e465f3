"""From WFPI to probabilities: WFSP (a fire, once lit, grows beyond 500 acres) and WLFP (large fires per area and day).

The USGS fits both by logistic regression on its fire history and publishes no coefficients. Those below are a
DEMONSTRATION: chosen so that the forecasts span the USGS's published reliability bins (WFSP 0.5 to over 30 %, WLFP 0.1
to over 7 per million km2-days), not fitted to any fire. Form: logit(WFSP) linear in WFPI plus a yearly cycle;
WLFP = ignition rate (log-linear in WFPI) x WFSP.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SpreadCoefficients:
    """Demonstration coefficients; ``ignitions_per_million_km2_day`` is that at WFPI 50 in mid season."""

    intercept: float = -6.2
    per_wfpi: float = 0.036
    season_amplitude: float = 0.4
    season_peak_day: float = 210.0
    ignitions_per_million_km2_day: float = 24.0
    ignitions_per_wfpi: float = 0.01


DEMONSTRATION = SpreadCoefficients()


def season_term(day_of_year: float, latitude_deg: Array, coefficients: SpreadCoefficients = DEMONSTRATION) -> Array:
    """Yearly cycle, +1 at the northern peak day and half a year later in the south."""
    phase = 2 * np.pi * (day_of_year - coefficients.season_peak_day) / 365.25
    return np.cos(phase) * np.sign(np.asarray(latitude_deg, dtype=np.float64))


def wfsp_pct(wfpi: Array, season: Array, coefficients: SpreadCoefficients = DEMONSTRATION) -> Array:
    """Probability in per cent that an ignited fire exceeds 500 acres (2.02 km2)."""
    logit = coefficients.intercept + coefficients.per_wfpi * wfpi + coefficients.season_amplitude * season
    return 100 / (1 + np.exp(-logit))


def wlfp_per_million_km2_day(wfpi: Array, season: Array, coefficients: SpreadCoefficients = DEMONSTRATION) -> Array:
    """Expected fires over 500 acres per million km2 and day."""
    exponent = coefficients.ignitions_per_wfpi * (wfpi - 50) + coefficients.season_amplitude * season
    ignitions = coefficients.ignitions_per_million_km2_day * np.exp(exponent)
    return ignitions * wfsp_pct(wfpi, season, coefficients) / 100
