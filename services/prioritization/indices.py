"""Fire weather indices on points and grids, SI in, units stated; NaN in any input gives NaN, never zero.

Inputs broadcast; a value that cannot be (300 degC, humidity of 200 %) is NaN, and more than one in a hundred of them is
a DomainError that names the input. ``index_catalogue`` states variant, source and agreement of each.

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

from services.prioritization.physical_ranges import physical
from shared.errors import DomainError

if TYPE_CHECKING:
    from climate_indices.fire import CFFWISState, KBDIState

Array = npt.NDArray[np.float64]

MPH_PER_M_S = 1 / 0.44704
KBDI_MAX_MM = 203.2
FFMC_CONSTANT = 250 * 59.5 / 101
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
    temperature = physical(temperature_c, "temperature_c")
    saturation = 6.108 * np.exp(17.27 * temperature / (temperature + 237.3))
    return saturation * (1 - physical(relative_humidity_pct, "relative_humidity_pct") / 100)


def dew_point_c(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike) -> Array:
    """Dew point in degrees Celsius, the inverse of FAO-56 equation 11; humidity below 0.1 % counts as 0.1 %."""
    temperature = physical(temperature_c, "temperature_c")
    humidity = np.maximum(physical(relative_humidity_pct, "relative_humidity_pct"), 0.1)
    exponent = np.log(humidity / 100) + 17.27 * temperature / (temperature + 237.3)
    return 237.3 * exponent / (17.27 - exponent)


def equilibrium_moisture_pct(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike) -> Array:
    """Equilibrium moisture content of fine dead fuel in per cent of dry weight (Simard 1968, as in Fosberg 1978).

    The regressions are in degrees Fahrenheit; they jump at 10 and 50 % humidity, which belong to the lower branch.
    """
    fahrenheit = physical(temperature_c, "temperature_c") * 1.8 + 32
    humidity = physical(relative_humidity_pct, "relative_humidity_pct")
    dry = 0.03229 + 0.281073 * humidity - 0.000578 * humidity * fahrenheit
    middle = 2.22749 + 0.160107 * humidity - 0.014784 * fahrenheit
    wet = 21.0606 + 0.005565 * humidity**2 - 0.00035 * humidity * fahrenheit - 0.483199 * humidity
    moisture = np.where(humidity <= 10, dry, np.where(humidity <= 50, middle, wet))
    return np.maximum(moisture, 0) + 0 * humidity  # NaN humidity falls through both comparisons: keep it NaN


def fuel_moisture_10h_pct(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike) -> Array:
    """10-h dead fuel moisture in per cent from the hour's air alone: 1.28 x equilibrium moisture (Burgan 1998)."""
    return 1.28 * equilibrium_moisture_pct(temperature_c, relative_humidity_pct)


def fosberg(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike, wind_speed_m_s: npt.ArrayLike) -> Array:
    """Fosberg fire weather index, 0-100 (capped: zero moisture and 30 mph); climate-indices 3.1."""
    result: Array = _fire_library().fosberg_ffwi(
        physical(temperature_c, "temperature_c"),
        physical(relative_humidity_pct, "relative_humidity_pct"),
        physical(wind_speed_m_s, "wind_speed_m_s"),
    )
    return result


def haines(
    temperature_lower_c: npt.ArrayLike,
    temperature_upper_c: npt.ArrayLike,
    dew_point_c: npt.ArrayLike,
    variant: Literal["low", "mid", "high"],
) -> Array:
    """Haines index 2-6: low 950/850 hPa (dew point 850), mid 850/700 (850), high 700/500 (700); climate-indices 3.1."""
    if variant not in ("low", "mid", "high"):
        raise DomainError(f"There is no Haines variant '{variant}'.", field="variant", accepted="low, mid, high")
    lower, upper = physical(temperature_lower_c, "temperature_c"), physical(temperature_upper_c, "temperature_c")
    result: Array = _fire_library().haines_index(lower, upper, physical(dew_point_c, "dew_point_c"), variant=variant)
    return result


def hot_dry_windy(
    temperature_c: npt.ArrayLike,
    relative_humidity_pct: npt.ArrayLike,
    wind_speed_m_s: npt.ArrayLike,
    height_agl_m: npt.ArrayLike,
) -> Array:
    """HDW in hPa m/s: largest VPD x wind within 500 m above ground, levels on the last axis; climate-indices 3.1."""
    result: Array = _fire_library().hot_dry_windy(
        physical(temperature_c, "temperature_c"),
        physical(relative_humidity_pct, "relative_humidity_pct"),
        physical(wind_speed_m_s, "wind_speed_m_s"),
        physical(height_agl_m, "height_agl_m"),
    )
    return result


def kbdi(
    rain_mm: npt.ArrayLike,
    temperature_max_c: npt.ArrayLike,
    annual_rain_mm: npt.ArrayLike,
    initial_mm: npt.ArrayLike = 0.0,
    state: KBDIState | None = None,
    bridged_days: int = 0,
) -> tuple[Array, KBDIState]:
    """Keetch-Byram drought index in mm (0-203.2), days first, and the state that the next day resumes from.

    Metric form of equation 18 with 8.30 (Alexander 1990); rain counts beyond the first 5.08 mm of a wet spell. Missing
    days as in ``canadian``.
    """
    start = physical(initial_mm, "kbdi_mm")
    seed: dict[str, Any] = {"initial_state": state} if state is not None else {"initial_kbdi": start}
    result = _fire_library().kbdi(
        physical(rain_mm, "rain_mm"),
        physical(temperature_max_c, "temperature_c"),
        physical(annual_rain_mm, "annual_rain_mm"),
        return_state=True,
        **_missing_days(bridged_days),
        **seed,
    )
    return result.values, result.state


def _missing_days(bridged_days: int) -> dict[str, Any]:
    return {"nan_policy": "bridge" if bridged_days else "propagate", "max_gap_days": bridged_days}


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
    start: tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike] | None = None,
    bridged_days: int = 0,
) -> CanadianIndices:
    """Canadian fire weather index system from noon (local standard) weather and 24 h rain (mm), days first.

    Starts from 85/6/15, or from ``start`` (FFMC, DMC, DC), or goes on from yesterday's ``state``. A day with a value
    missing is NaN; the codes go on after it from the day before if at most ``bridged_days`` are missing in a row, else
    they stay NaN.
    """
    seed: dict[str, Any] = {"initial_state": state}
    if state is None and start is not None:
        seed = dict(zip(("initial_ffmc", "initial_dmc", "initial_dc"), start, strict=True))
    result = _fire_library().cffwis(
        physical(temperature_c, "temperature_c"),
        physical(relative_humidity_pct, "relative_humidity_pct"),
        physical(wind_speed_m_s, "wind_speed_m_s"),
        physical(rain_mm, "rain_mm"),
        physical(latitude_deg, "latitude_deg"),
        month,
        return_state=True,
        **_missing_days(bridged_days),
        **seed,
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
        - 0.0345 * physical(relative_humidity_pct, "relative_humidity_pct")
        + 0.0338 * physical(temperature_c, "temperature_c")
        + 0.0234 * 3.6 * physical(wind_speed_m_s, "wind_speed_m_s")
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
    temperature = physical(temperature_c, "temperature_c")
    depression_f = 1.8 * (temperature - dew_point_c(temperature, relative_humidity_pct))
    wind_mph = physical(wind_speed_m_s, "wind_speed_m_s") * MPH_PER_M_S
    return 0.001 * wind_mph**2 * depression_f * np.asarray(fuel_moisture_component, dtype=np.float64)


def fuel_moisture_component(
    dryness_level: npt.ArrayLike, live_fuel_moisture: npt.ArrayLike, green_up: npt.ArrayLike
) -> Array:
    """FMC of LFP, 0-1: (0.1 [(DL / LFM - 1) + G])^1.7, clipped (Rolinski et al. 2016).

    ``dryness_level`` DL 1-3 of the dead fuels, ``live_fuel_moisture`` LFM as a fraction (0.6 = 60 %), ``green_up`` G
    0 (grass green) to 5 (fully cured). The bracket is read so that the driest fuels (3, 0.5, 5) give 1.
    """
    live = np.asarray(live_fuel_moisture, dtype=np.float64)
    if np.any(live > 5):
        raise DomainError(
            "Live fuel moisture is a fraction here.",
            field="live_fuel_moisture",
            value=float(np.nanmax(live)),
            accepted="0.3..5 (0.6 is 60 %)",
        )
    dry = np.asarray(dryness_level, dtype=np.float64) / np.maximum(live, 0.05) - 1
    return np.clip(0.1 * (dry + np.asarray(green_up, dtype=np.float64)), 0, 1) ** 1.7


def equilibrium_ffmc(temperature_c: npt.ArrayLike, relative_humidity_pct: npt.ArrayLike) -> Array:
    """FFMC (0-101) in balance with the air: the drying equilibrium of Van Wagner 1987, no rain, no yesterday.

    Stands in for FFMC where there is no series of days to run it over.
    """
    t = physical(temperature_c, "temperature_c")
    h = physical(relative_humidity_pct, "relative_humidity_pct")
    drying = 0.942 * h**0.679 + 11 * np.exp((h - 100) / 10) + 0.18 * (21.1 - t) * -np.expm1(-0.115 * h)
    moisture = np.maximum(drying, 0)
    return np.clip(59.5 * (250 - moisture) / (FFMC_CONSTANT + moisture), 0, 101)


def initial_spread(ffmc: npt.ArrayLike, wind_speed_m_s: npt.ArrayLike) -> Array:
    """Initial spread index from a fine fuel moisture code and wind; climate-indices 3.1."""
    result: Array = _fire_library().initial_spread_index(ffmc, physical(wind_speed_m_s, "wind_speed_m_s"))
    return result


def sawti_category(lfp: npt.ArrayLike, zone: int) -> Array:
    """Santa Ana wildfire threat category 0 (none) to 4 (extreme) of a zone 1-4; NaN where LFP is NaN."""
    if zone not in SAWTI_THRESHOLDS:
        raise DomainError(f"There is no SAWTI zone {zone}.", field="zone", value=zone, accepted="1, 2, 3 or 4")
    values = np.asarray(lfp, dtype=np.float64)
    category = np.digitize(values, SAWTI_THRESHOLDS[zone]).astype(np.float64)
    return np.where(np.isnan(values), np.nan, category)
