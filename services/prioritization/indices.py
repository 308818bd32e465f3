"""Fire weather indices on points and grids; NaN in any input gives NaN, never zero.

Canadian FWI system, KBDI, Fosberg, Haines and HDW come from climate-indices 3.1 (its CFFWI agrees with cffdrs to 0.005,
with FFMC's constant 147.27723; its KBDI is the 1968 paper's wet-spell variant with Alexander's 8.30, not the Australian
one). Written here: equilibrium moisture (Simard 1968), vapour pressure deficit and dew point (FAO-56), the forest fire
danger index (McArthur Mark 5 after Noble et al. 1980) and LFP with its SAWTI category (Rolinski et al. 2016).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from shared.errors import DomainError

if TYPE_CHECKING:
    from climate_indices.fire import CFFWISState, KBDIState

Array = npt.NDArray[np.float64]

MPH_PER_M_S = 1 / 0.44704
KBDI_MAX_MM = 203.2
SAWTI_THRESHOLDS: dict[int, tuple[float, float, float, float]] = {
    1: (10, 15, 21, 40),
    2: (9, 13, 20, 28),
    3: (10, 16, 24, 36),
    4: (9, 12, 15, 25),
}


@cache
def _fire_library() -> Any:
    """climate_indices.fire, with its two log lines per call (on standard output) silenced."""
    import structlog
    from climate_indices import _recurrence, fire
    from climate_indices.fire import _cffwis_codes, _fosberg, _haines, _hdw

    quiet = structlog.make_filtering_bound_logger(logging.ERROR)
    for module in (_recurrence, _cffwis_codes, _fosberg, _haines, _hdw):
        module._logger = structlog.wrap_logger(structlog.PrintLogger(), wrapper_class=quiet)
    return fire


def vapour_pressure_deficit_hpa(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike) -> Array:
    """Vapour pressure deficit in hPa (FAO-56 equation 11 for saturation)."""
    temperature = np.asarray(temperature_c, dtype=np.float64)
    saturation = 6.108 * np.exp(17.27 * temperature / (temperature + 237.3))
    return saturation * (1 - np.asarray(relative_humidity_pct, dtype=np.float64) / 100)


def dew_point_c(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike) -> Array:
    """Dew point in degrees Celsius, the inverse of FAO-56 equation 11; humidity below 0.1 % counts as 0.1 %."""
    temperature = np.asarray(temperature_c, dtype=np.float64)
    humidity = np.maximum(np.asarray(relative_humidity_pct, dtype=np.float64), 0.1)
    exponent = np.log(humidity / 100) + 17.27 * temperature / (temperature + 237.3)
    return 237.3 * exponent / (17.27 - exponent)


def equilibrium_moisture_pct(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike) -> Array:
    """Equilibrium moisture content of fine dead fuel in per cent of dry weight (Simard 1968, as in Fosberg 1978).

    The regressions are in degrees Fahrenheit; they jump at 10 and 50 % humidity, which belong to the lower branch.
    """
    fahrenheit = np.asarray(temperature_c, dtype=np.float64) * 1.8 + 32
    humidity = np.asarray(relative_humidity_pct, dtype=np.float64)
    dry = 0.03229 + 0.281073 * humidity - 0.000578 * humidity * fahrenheit
    middle = 2.22749 + 0.160107 * humidity - 0.014784 * fahrenheit
    wet = 21.0606 + 0.005565 * humidity**2 - 0.00035 * humidity * fahrenheit - 0.483199 * humidity
    moisture = np.where(humidity <= 10, dry, np.where(humidity <= 50, middle, wet))
    return np.maximum(moisture, 0) + 0 * humidity  # NaN humidity falls through both comparisons: keep it NaN


def fosberg(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike, wind_speed_m_s: npt.ArrayLike) -> Array:
    """Fosberg fire weather index, 0-100 (capped: zero moisture and 30 mph); climate-indices 3.1."""
    result: Array = _fire_library().fosberg_ffwi(temperature_c, relative_humidity_pct, wind_speed_m_s)
    return result


def haines(
    temperature_lower_c: npt.ArrayLike,
    temperature_upper_c: npt.ArrayLike,
    dew_point_c: npt.ArrayLike,
    variant: Literal["low", "mid", "high"],
) -> Array:
    """Haines index 2-6: low 950/850 hPa (dew point 850), mid 850/700 (850), high 700/500 (700); climate-indices 3.1."""
    result: Array = _fire_library().haines_index(temperature_lower_c, temperature_upper_c, dew_point_c, variant=variant)
    return result


def hot_dry_windy(
    temperature_c: npt.ArrayLike,
    relative_humidity_pct: npt.ArrayLike,
    wind_speed_m_s: npt.ArrayLike,
    height_agl_m: npt.ArrayLike,
) -> Array:
    """HDW in hPa m/s: largest VPD x wind within 500 m above ground, levels on the last axis; climate-indices 3.1."""
    result: Array = _fire_library().hot_dry_windy(temperature_c, relative_humidity_pct, wind_speed_m_s, height_agl_m)
    return result


def kbdi(
    rain_mm: npt.ArrayLike,
    temperature_max_c: npt.ArrayLike,
    annual_rain_mm: npt.ArrayLike,
    initial_mm: npt.ArrayLike = 0.0,
    state: KBDIState | None = None,
) -> tuple[Array, KBDIState]:
    """Keetch-Byram drought index in mm (0-203.2), days first, and the state that the next day resumes from.

    Metric form of equation 18 with 8.30 (Alexander 1990); rain counts beyond the first 5.08 mm of a wet spell.
    """
    seed: dict[str, Any] = {"initial_state": state} if state is not None else {"initial_kbdi": initial_mm}
    result = _fire_library().kbdi(rain_mm, temperature_max_c, annual_rain_mm, return_state=True, **seed)
    return result.values, result.state


@dataclass(frozen=True)
class CanadianIndices:
    """The Canadian system's codes and indices, days first, with the state that the next day resumes from."""

    ffmc: Array
    dmc: Array
    dc: Array
    isi: Array
    bui: Array
    fwi: Array
    state: CFFWISState


def canadian(
    temperature_c: npt.ArrayLike,
    relative_humidity_pct: npt.ArrayLike,
    wind_speed_m_s: npt.ArrayLike,
    rain_mm: npt.ArrayLike,
    latitude_deg: npt.ArrayLike,
    month: npt.ArrayLike,
    state: CFFWISState | None = None,
) -> CanadianIndices:
    """Canadian fire weather index system from noon (local standard) weather and 24 h rain; start-up values 85/6/15."""
    result = _fire_library().cffwis(
        temperature_c,
        relative_humidity_pct,
        wind_speed_m_s,
        rain_mm,
        latitude_deg,
        month,
        initial_state=state,
        return_state=True,
    )
    codes = {name: getattr(result, name) for name in ("ffmc", "dmc", "dc", "isi", "bui", "fwi")}
    return CanadianIndices(**codes, state=result.state)


def overwintered_dc(
    autumn_dc: npt.ArrayLike, winter_rain_mm: npt.ArrayLike, carry_over: float = 0.75, wetting_efficiency: float = 0.75
) -> Array:
    """Drought code at start-up in spring from last autumn's and the rain between (Lawson & Armitage 2008)."""
    result: Array = _fire_library().overwinter_drought_code(
        autumn_dc, winter_rain_mm, carry_over_fraction=carry_over, wetting_efficiency=wetting_efficiency
    )
    return result


def drought_factor_dry(kbdi_mm: npt.ArrayLike) -> Array:
    """Drought factor 0-10 from KBDI (mm) where no rain weighs on it (Griffiths 1999, the limit without recent rain)."""
    factor = 10.5 * (1 - np.exp(-(np.asarray(kbdi_mm, dtype=np.float64) + 30) / 40))
    return np.clip(factor, 0, 10)


def forest_fire_danger(
    temperature_c: npt.ArrayLike,
    relative_humidity_pct: npt.ArrayLike,
    wind_speed_m_s: npt.ArrayLike,
    drought_factor: npt.ArrayLike,
) -> Array:
    """McArthur forest fire danger index, Mark 5 (Noble et al. 1980); unbounded above, 100 = the fires of 1939."""
    exponent = (
        -0.45
        + 0.987 * np.log(np.maximum(np.asarray(drought_factor, dtype=np.float64), 1e-6))
        - 0.0345 * np.asarray(relative_humidity_pct, dtype=np.float64)
        + 0.0338 * np.asarray(temperature_c, dtype=np.float64)
        + 0.0234 * 3.6 * np.asarray(wind_speed_m_s, dtype=np.float64)
    )
    return 2 * np.exp(exponent)


def large_fire_potential(
    wind_speed_m_s: npt.ArrayLike,
    temperature_c: npt.ArrayLike,
    relative_humidity_pct: npt.ArrayLike,
    fuel_moisture_component: npt.ArrayLike = 1.0,
) -> Array:
    """LFP = 0.001 Ws2 Dd FMC (Rolinski et al. 2016), with Ws in mph and Dd, the dew-point depression, in deg F.

    Inputs are SI; both conversions happen here (m/s with deg F gives a fifth of it). ``fuel_moisture_component`` is
    0-1; left at 1 the result is LFP without fuel. Meant for offshore wind in Southern California.
    """
    temperature = np.asarray(temperature_c, dtype=np.float64)
    depression_f = 1.8 * (temperature - dew_point_c(temperature, relative_humidity_pct))
    wind_mph = np.asarray(wind_speed_m_s, dtype=np.float64) * MPH_PER_M_S
    return 0.001 * wind_mph**2 * depression_f * np.asarray(fuel_moisture_component, dtype=np.float64)


def sawti_category(lfp: npt.ArrayLike, zone: int) -> Array:
    """Santa Ana wildfire threat category 0 (none) to 4 (extreme) of a zone 1-4; NaN where LFP is NaN."""
    if zone not in SAWTI_THRESHOLDS:
        raise DomainError(f"There is no SAWTI zone {zone}.", field="zone", value=zone, accepted="1, 2, 3 or 4")
    values = np.asarray(lfp, dtype=np.float64)
    category = np.digitize(values, SAWTI_THRESHOLDS[zone]).astype(np.float64)
    return np.where(np.isnan(values), np.nan, category)
