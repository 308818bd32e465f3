"""The pre-fire danger of a block of cells: WFPI, WLFP and WFSP of each lead day, without and with what was seen.

The grid is rated row block by row block, so that 13 million cells need no more memory than a few thousand rows of
whatever is asked for; every layer with ``_x`` comes from the same functions as its plain twin, so that a cell where
nothing was seen has the same bits in both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization.prefire import (
    burn_scar,
    conditions,
    danger_grid,
    fire_potential,
    fire_probability,
    soil_moisture,
)
from services.prioritization.prefire.fuels import VEGETATION_IMPOSSIBLE, Fuels, SampledFuels

Array = npt.NDArray[np.floating[Any]]
FpiVersion = Literal["1998", "2000"]
FuelsSource = Fuels | SampledFuels
BLOCK_CELLS = 400_000


@dataclass(frozen=True)
class DangerEffects:
    """The stated forms of everything that no publication fixes."""

    terms: fire_potential.WeatherTerms = field(default_factory=fire_potential.WeatherTerms)
    soil_moisture: soil_moisture.SoilMoistureEffect = field(default_factory=soil_moisture.SoilMoistureEffect)
    burn_scar: burn_scar.BurnScarEffect = field(default_factory=burn_scar.BurnScarEffect)
    probability: fire_probability.FireProbability = field(default_factory=fire_probability.shipped)


@dataclass(frozen=True)
class SeenLand:
    """What of the land was seen: the soil moisture of the EASE cells, and the burn scar of each cell (y, x)."""

    soil_moisture: soil_moisture.SoilMoistureLayer | None
    scar: Array | None


def seen_land(
    grid: danger_grid.DangerGrid,
    soil_moisture_tables: list[pd.DataFrame],
    burned_area: list[pd.DataFrame],
    time: pd.Timestamp,
    effects: DangerEffects,
    resolution_km: int = 9,
) -> SeenLand:
    """Soil moisture and burn scars known at ``time``."""
    layer = soil_moisture.latest_layer(soil_moisture_tables, time, effects.soil_moisture, resolution_km)
    scar = burn_scar.burn_scar(burned_area, grid, time, effects.burn_scar, np.float32) if burned_area else None
    return SeenLand(layer, scar)


@dataclass(frozen=True)
class SeenBlock:
    """What was seen of a block, each (y, x): weight and position of the soil moisture, share of fuel lost to scars."""

    weight: Array
    position: Array
    scar: Array
    greenness_x: Array

    @property
    def anything(self) -> bool:
        return bool((self.weight > 0).any() or (self.scar > 0).any())


@dataclass(frozen=True)
class DangerBlock:
    """A block's danger: each index (lead_day, y, x), NaN on masked and unknown cells; ``flag`` says why unknown.

    ``longitude_deg`` and ``latitude_deg`` of the cells broadcast to (y, x).
    """

    rows: slice
    longitude_deg: Array
    latitude_deg: Array
    fuels: Fuels
    seen: SeenBlock
    wfpi: Array
    wfpi_x: Array
    flag: npt.NDArray[np.uint8]


def blocks(
    fuels: FuelsSource,
    daily: conditions.DailyConditions,
    seen: SeenLand,
    time: pd.Timestamp,
    version: FpiVersion = "2000",
    effects: DangerEffects | None = None,
    block_cells: int = BLOCK_CELLS,
) -> Iterator[DangerBlock]:
    """The danger of every row block of the fuels' grid, from its first row on.

    A grid of 1 km is computed in four-byte numbers, any other in eight.
    """
    effects = effects or DangerEffects()
    height, width = fuels.grid.shape
    step = max(1, block_cells // width)
    for first in range(0, height, step):
        rows = slice(first, min(first + step, height))
        yield _block(rows, fuels.rows(rows), daily, seen, time, version, effects)


def _block(
    rows: slice,
    fuels: Fuels,
    daily: conditions.DailyConditions,
    seen: SeenLand,
    time: pd.Timestamp,
    version: FpiVersion,
    effects: DangerEffects,
) -> DangerBlock:
    longitude, latitude = fuels.grid.places(rows)
    block_seen = _seen_block(fuels, seen, rows, (longitude, latitude), time, effects.soil_moisture)
    air = conditions.on_cells(daily, longitude, latitude, fuels.greenness.dtype)
    factor = effects.terms.factor(air.wind_speed_m_s, air.temperature_c, air.rain_mm)
    plain = wfpi_of(fuels.greenness, fuels, air.moisture_10h_pct, factor, version)
    if block_seen.anything:
        seen_wfpi = wfpi_of(block_seen.greenness_x, fuels, air.moisture_10h_pct, factor, version)
        seen_wfpi *= 1 - block_seen.scar
    else:
        seen_wfpi = plain
    flag = fuels.flag | air.flag
    flag[np.isnan(plain) & (flag == 0)] = VEGETATION_IMPOSSIBLE  # such as no fuel load at all
    flag = np.where(fuels.mask_code >= 248, np.uint8(0), flag)
    return DangerBlock(rows, longitude, latitude, fuels, block_seen, plain, seen_wfpi, flag)


def _seen_block(
    fuels: Fuels,
    seen: SeenLand,
    rows: slice,
    places: tuple[Array, Array],
    time: pd.Timestamp,
    effect: soil_moisture.SoilMoistureEffect,
) -> SeenBlock:
    shape, kind = fuels.greenness.shape, fuels.greenness.dtype
    scar = np.zeros(shape, dtype=kind) if seen.scar is None else seen.scar[rows].astype(kind)
    nothing = SeenBlock(np.zeros(shape, dtype=kind), np.full(shape, 0.5, dtype=kind), scar, fuels.greenness)
    if seen.soil_moisture is None:
        return nothing
    moisture, weight = seen.soil_moisture.at(*places, kind)
    if not (weight > 0).any():
        return nothing
    position = soil_moisture.position(moisture, fuels.soil_moisture_q05, fuels.soil_moisture_q95).astype(kind)
    growing = soil_moisture.growing_season(float(time.dayofyear), places[1]).astype(kind)
    strength = soil_moisture.alpha(growing, fuels.live_load, fuels.dead_load, effect)
    greenness = soil_moisture.greenness_with_soil_moisture(fuels.greenness, weight, strength, position)
    return SeenBlock(weight, position, scar, greenness)


def wfpi_of(greenness: Array, fuels: Fuels, moisture_10h_pct: Array, factor: Array, version: FpiVersion) -> Array:
    """WFPI (lead_day, y, x) for a greenness (y, x); NaN on masked cells and where anything is unknown."""
    if version == "1998":
        fpi = fire_potential.fpi_1998(
            greenness, fuels.live_load, fuels.dead_load, moisture_10h_pct, fuels.extinction_pct
        )
    else:
        share = fire_potential.live_ratio(greenness, fuels.ndvi_max, fuels.ndvi_largest)
        fpi = fire_potential.fpi_2000(share, moisture_10h_pct, fuels.extinction_pct)
    values = fire_potential.wfpi(fpi, factor)
    values[..., fuels.mask_code >= 248] = np.nan
    return values
