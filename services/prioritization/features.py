"""The large-fire model's columns: one function computes the derived ones for training and for rating alike.

Two schemas. ``loop``: what the daily loop can supply for any fire from weather and drought alone. ``full``: those and
the land and fuel columns of the Victorian wildfire research table, which no case of the loop carries.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from services.prioritization import indices
from shared.errors import DomainError

Schema = Literal["loop", "full"]


@dataclass(frozen=True)
class Feature:
    """A model column: its name for people, its unit, and the sign of its effect where physics fixes one."""

    name: str
    label: str
    unit: str
    monotone: int = 0


LOOP_FEATURES = (
    Feature("temperature_c", "temperature", "degC", 1),
    Feature("relative_humidity_pct", "relative humidity", "%", -1),
    Feature("wind_speed_m_s", "wind", "m/s", 1),
    Feature("kbdi_mm", "KBDI", "mm", 1),
    Feature("vpd_hpa", "vapour pressure deficit", "hPa", 1),
    Feature("dead_fuel_moisture_10h_pct", "10-h fuel moisture", "%", -1),
    Feature("ffdi_dry", "FFDI without recent rain", "", 1),
)
LAND_FEATURES = (
    Feature("soil_moisture", "root-zone soil moisture", "", -1),
    Feature("curing_pct", "grass curing", "%", 0),
    Feature("drought_factor", "drought factor", "", 0),
    Feature("ffdi", "FFDI", "", 1),
    Feature("gfdi", "GFDI", "", 0),
    Feature("grass_density_3km", "grass within 3 km", ""),
    Feature("forest_density_3km", "forest within 3 km", ""),
    Feature("shrub_density_3km", "shrub within 3 km", ""),
    Feature("noveg_density_3km", "bare within 3 km", ""),
    Feature("distance_to_interface", "distance to grass-bush edge", "cells of 30 m"),
    Feature("elevation_m", "elevation", "m"),
    Feature("ruggedness_average_3km", "ruggedness", ""),
    Feature("building_density_3km", "buildings within 3 km", ""),
    Feature("building_density_20km", "buildings within 20 km", ""),
    Feature("road_density_km_in_3km", "roads within 3 km", "km"),
    Feature("road_distance_m", "distance to road", "m"),
)
INDICES: dict[str, int] = {
    "ffdi_dry": 1,
    "ffwi": 1,
    "kbdi_mm": 1,
    "vpd_hpa": 1,
    "hdw_surface": 1,
    "lfp_weather": 1,
    "dead_fuel_moisture_10h_pct": -1,
}
"""Single indices that the model is held against, with the sign that makes a larger value more dangerous."""

VICTORIA_COLUMNS = {
    "T_SFC_historical": "temperature_c",
    "RH_SFC_historical": "relative_humidity_pct",
    "WindMagKmh_SFC_historical": "wind_speed_km_h",
    "KBDI_historical": "kbdi_mm",
    "Curing_historical": "curing_pct",
    "DF_SFC_historical": "drought_factor",
    "FFDI_historical": "ffdi",
    "GFDI_historical": "gfdi",
}
PRIMITIVES = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "kbdi_mm")


def features_of(schema: Schema) -> tuple[Feature, ...]:
    """The columns of a schema in the order that the model is trained and asked in."""
    return LOOP_FEATURES if schema == "loop" else LOOP_FEATURES + LAND_FEATURES


def derive(primitives: pd.DataFrame) -> pd.DataFrame:
    """The primitives with every derived column and index added (units in the names); NaN stays NaN.

    Needs temperature_c, relative_humidity_pct, wind_speed_m_s, kbdi_mm (0-203.2). A 10-h moisture already there is kept
    (the time-lag forecast), elsewhere it is Burgan's 1.28 x equilibrium moisture, which stands for the same thing.
    """
    for name in PRIMITIVES:
        if name not in primitives.columns:
            raise DomainError(
                f"The table lacks the column '{name}'; it has {', '.join(map(str, primitives.columns))}.",
                field=name,
                accepted=", ".join(PRIMITIVES),
            )
    frame = primitives.copy()
    t, rh, wind, drought = (frame[name].to_numpy(dtype=np.float64) for name in PRIMITIVES)
    frame["vpd_hpa"] = indices.vapour_pressure_deficit_hpa(t, rh)
    burgan = 1.28 * indices.equilibrium_moisture_pct(t, rh)
    given = frame.get("dead_fuel_moisture_10h_pct", pd.Series(np.nan, index=frame.index)).to_numpy(dtype=np.float64)
    frame["dead_fuel_moisture_10h_pct"] = np.where(np.isnan(given), burgan, given)
    frame["ffdi_dry"] = indices.forest_fire_danger(t, rh, wind, indices.drought_factor_dry(drought))
    frame["hdw_surface"] = frame["vpd_hpa"] * wind
    frame["lfp_weather"] = indices.large_fire_potential(wind, t, rh)
    frame["ffwi"] = indices.fosberg(t, rh, wind)
    return frame


def from_victoria(table: pd.DataFrame) -> pd.DataFrame:
    """The Victorian table with our names and units: wind in m/s, derived columns added; labels and season kept."""
    missing = [name for name in VICTORIA_COLUMNS if name not in table.columns]
    if missing:
        raise DomainError(f"The table lacks the column '{missing[0]}'.", field=missing[0])
    drop = [column for column in set(VICTORIA_COLUMNS.values()) if column in table.columns]
    frame = table.drop(columns=drop).rename(columns=VICTORIA_COLUMNS)
    frame["wind_speed_m_s"] = frame["wind_speed_km_h"] / 3.6
    return derive(frame)
