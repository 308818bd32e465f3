"""Fire potential of vegetation: relative greenness, live ratio, FPI as published, and WFPI.

FPI after Burgan, Klaver & Klaver (1998) and its revision of 2000 (live ratio from maximum NDVI); a scale of 0-100. WFPI
adds wind, temperature and rain. The USGS has published no equation for those three, so this one is ours: each is a
factor that is 1 under neutral weather, and then WFPI is FPI. Wind and temperature enter as the square root of their
factors in McArthur's index (Noble et al. 1980: 0.0234 per km/h, 0.0338 per degC; that index runs over two decades where
FPI runs over one, and humidity is in FPI already), neutral at 15 km/h and 25 degC. Rain of the day beyond 0.5 mm (the
CFFWI's interception) lowers it by e per 10 mm. Values may exceed 100, up to 247.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import DomainError

Array = npt.NDArray[np.floating[Any]]

MASK_CODES: dict[int, str] = {
    248: "outside the area",
    249: "outside the area",
    250: "snow or ice",
    251: "agriculture",
    252: "barren",
    253: "marsh",
    254: "water",
    255: "no data",
}
LARGEST_VALUE = 247.0


@dataclass(frozen=True)
class WeatherTerms:
    """The three weather factors of WFPI; at the neutral values each is 1."""

    wind_per_m_s: float = 0.5 * 0.0234 * 3.6
    neutral_wind_m_s: float = 15 / 3.6
    temperature_per_c: float = 0.5 * 0.0338
    neutral_temperature_c: float = 25.0
    rain_threshold_mm: float = 0.5
    rain_scale_mm: float = 10.0
    wind_limit_m_s: float = 20.0
    temperature_limits_c: tuple[float, float] = (0.0, 45.0)

    def factor(self, wind_speed_m_s: Array, temperature_c: Array, rain_mm: Array) -> Array:
        """Product of the three factors; wind in m/s at 10 m, daily maximum temperature in degC, 24 h rain in mm."""
        wind = np.minimum(wind_speed_m_s, self.wind_limit_m_s) - self.neutral_wind_m_s
        warmth = np.clip(temperature_c, *self.temperature_limits_c) - self.neutral_temperature_c
        wet = np.maximum(rain_mm - self.rain_threshold_mm, 0) / self.rain_scale_mm
        return np.exp(self.wind_per_m_s * wind + self.temperature_per_c * warmth - wet)


def relative_greenness(ndvi: Array, ndvi_min: Array, ndvi_max: Array) -> Array:
    """RG in 0..1: where NDVI (-1..1) lies between the place's own extremes; NaN where those coincide or are swapped.

    USGS: RG = 100 (NDVI - min) / (max - min); beyond the extremes it is held at 0 or 1.
    """
    span = np.where(ndvi_max > ndvi_min, ndvi_max - ndvi_min, np.nan)
    return np.clip((ndvi - ndvi_min) / span, 0, 1)


def fpi_1998(
    greenness: Array, live_load: Array, dead_load: Array, moisture_10h_pct: Array, extinction_pct: Array
) -> Array:
    """FPI 0-100 of 1998: loads in any one unit, moistures in per cent.

    Live fraction lf = live x RG / (live + dead); FPIu = 100 - 100 (RG lf + TN df); the last line stretches it so that
    the driest and deadest fuel (2 % moisture) reaches 100; drier fuel stays there.
    """
    live_fraction = live_load * greenness / (live_load + dead_load)
    dryness = np.minimum(moisture_10h_pct / extinction_pct, 1)
    unscaled = 100 - 100 * (greenness * live_fraction + dryness * (1 - live_fraction))
    largest = 100 * (1 - 2 / extinction_pct)
    return np.minimum(unscaled + (2 / extinction_pct) * (unscaled / largest) * 100, 100)


def live_ratio(greenness: Array, ndvi_max: Array, absolute_max: float) -> Array:
    """Live share of the fuel (2000 revision): RG x (0.25 + 0.5 NDVImax / the largest NDVI of the whole area)."""
    return greenness * (0.25 + 0.5 * ndvi_max / absolute_max)


def fpi_2000(live_share: Array, moisture_10h_pct: Array, extinction_pct: Array) -> Array:
    """FPI 0-100 of 2000: 100 (1 - live ratio)(1 - TN), TN = (FM10 - 2) / (extinction - 2) within 0..1."""
    fraction = np.clip((moisture_10h_pct - 2) / (extinction_pct - 2), 0, 1)
    return 100 * (1 - live_share) * (1 - fraction)


def wfpi(fpi: Array, factor: Array) -> Array:
    """WFPI 0-247: FPI times the weather's factor; exactly FPI where that is 1, NaN where anything is unknown."""
    return np.clip(fpi * factor, 0, LARGEST_VALUE)


def coded(values: Array, mask_code: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The USGS's integer layer (..., y, x): rounded values 0-247, mask codes 248-255, 255 where nothing is known."""
    rounded = np.where(np.isnan(values), 255, np.rint(values)).astype(np.uint8)
    return np.where(mask_code >= 248, mask_code, rounded)


def coded_tenths(values: Array, mask_code: npt.NDArray[np.uint8]) -> npt.NDArray[np.int16]:
    """WLFP or WFSP (..., y, x) in the USGS's tenths: values times ten up to 2479, mask codes times ten (2480-2550)."""
    tenths = np.where(np.isnan(values), 2550, np.clip(np.rint(values * 10), 0, 2479)).astype(np.int16)
    return np.where(mask_code >= 248, mask_code.astype(np.int16) * np.int16(10), tenths)


def checked_mask(mask_code: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Mask codes as bytes; DomainError for a code that means nothing."""
    codes = np.asarray(mask_code)
    known = np.isin(codes, [0, *MASK_CODES])
    if not known.all():
        value = codes[~known].flat[0]
        raise DomainError(
            f"'mask_code' holds {value}.", field="mask_code", value=value, accepted="0 or a USGS code 248..255"
        )
    return codes.astype(np.uint8)
