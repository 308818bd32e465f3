"""The large-fire model's columns: one schema for every table, one function that derives the same columns everywhere.

Each feature says its group (index, weather, moisture, land) and which sources carry it: ``loop`` (weather, drought and
fuel moisture that every case has), ``victoria`` (Victorian Wildfire Research Dataset), ``us`` (gridMET with ICS-209).
A feature that no source carries is listed all the same, with the reason (``NOT_CARRIED``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from services.prioritization import indices
from services.prioritization.physical_ranges import physical
from shared.errors import DomainError

Schema = Literal["loop", "full", "us"]
Group = Literal["index", "weather", "moisture", "land"]
GROUPS: tuple[Group, ...] = ("index", "weather", "moisture", "land")

_ALL = frozenset({"loop", "full", "us"})
_DROUGHT = frozenset({"loop", "full"})
_VICTORIA = frozenset({"full"})
_US = frozenset({"us"})


@dataclass(frozen=True)
class Feature:
    """A model column: name for people, unit, group, who carries it, sign of its effect where physics fixes one.

    ``danger``: sign that makes a larger value more dangerous where the column is held against the model as a single
    index (0: it is not).
    """

    name: str
    label: str
    unit: str
    group: Group
    carried: frozenset[str]
    monotone: int = 0
    danger: int = 0

    @property
    def sign(self) -> int:
        """Sign of the column's effect: that of a monotone feature, or of a danger index."""
        return self.monotone or self.danger


def _index(name: str, label: str, unit: str, carried: frozenset[str], sign: int = 0) -> Feature:
    return Feature(name, label, unit, "index", carried, sign, 1)


def _land(name: str, label: str, unit: str = "") -> Feature:
    return Feature(name, label, unit, "land", _VICTORIA)


FEATURES = (
    Feature("temperature_c", "temperature", "degC", "weather", _ALL, 1),
    Feature("relative_humidity_pct", "relative humidity", "%", "weather", _ALL, -1),
    Feature("wind_speed_m_s", "wind", "m/s", "weather", _ALL, 1),
    _index("kbdi_mm", "KBDI", "mm", _DROUGHT, 1),
    Feature("vpd_hpa", "vapour pressure deficit", "hPa", "weather", _ALL, 1, 1),
    Feature("dead_fuel_moisture_10h_pct", "10-h fuel moisture", "%", "moisture", _ALL, -1, -1),
    _index("ffdi_dry", "FFDI without recent rain", "", _DROUGHT, 1),
    _index("ffwi", "Fosberg index", "", _ALL, 1),
    _index("hdw_surface", "HDW at the surface", "hPa m/s", _ALL, 1),
    _index("lfp_weather", "LFP without fuel", "", _ALL, 1),
    _index("sawti_weather", "SAWTI category of LFP without fuel", "", _ALL, 1),
    _index("ffmc_equilibrium", "FFMC in balance with the air", "", _ALL, 1),
    _index("isi_equilibrium", "ISI of that FFMC", "", _ALL, 1),
    _index("ffdi", "FFDI", "", _VICTORIA, 1),
    _index("gfdi", "GFDI", "", _VICTORIA),
    Feature("erc", "energy release component", "", "index", _US, 1, 1),
    Feature("bi", "burning index", "", "index", _US, 1, 1),
    Feature("soil_moisture", "root-zone soil moisture", "", "moisture", _VICTORIA, -1),
    Feature("drought_factor", "drought factor", "", "moisture", _VICTORIA, 0, 1),
    Feature("fm100", "100-h fuel moisture", "%", "moisture", _US, -1, -1),
    Feature("fm1000", "1000-h fuel moisture", "%", "moisture", _US, -1, -1),
    _land("curing_pct", "grass curing", "%"),
    _land("grass_density_3km", "grass within 3 km"),
    _land("forest_density_3km", "forest within 3 km"),
    _land("shrub_density_3km", "shrub within 3 km"),
    _land("noveg_density_3km", "bare within 3 km"),
    _land("distance_to_interface", "distance to grass-bush edge", "cells of 30 m"),
    _land("elevation_m", "elevation", "m"),
    _land("ruggedness_average_3km", "ruggedness"),
    _land("building_density_3km", "buildings within 3 km"),
    _land("building_density_20km", "buildings within 20 km"),
    _land("road_density_km_in_3km", "roads within 3 km", "km"),
    _land("road_distance_m", "distance to road", "m"),
)
BY_NAME = {feature.name: feature for feature in FEATURES}

NOT_CARRIED: dict[str, str] = {
    "LFP (with fuel)": "no table has live fuel moisture or green-up, which its fuel moisture component needs",
    "SAWTI category (with fuel)": "follows LFP; without fuel it is the category of LFP without fuel, zone 1",
    "Haines": "no table has upper-air temperatures; computed where pressure levels are given (index maps)",
    "DMC": "needs weeks of daily weather before each fire: Victoria withholds dates, the US windows are days",
    "FFMC, ISI": "need the days before; what stands in is the value in balance with the hour's air, rain unknown",
}

VICTORIA_COLUMNS = {
    "T_SFC": "temperature_c",
    "RH_SFC": "relative_humidity_pct",
    "WindMagKmh_SFC": "wind_speed_km_h",
    "KBDI": "kbdi_mm",
    "Curing": "curing_pct",
    "DF_SFC": "drought_factor",
    "FFDI": "ffdi",
    "GFDI": "gfdi",
}
PRIMITIVES = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s", "kbdi_mm")
US_NUMBERS = ("tmmx", "rmin", "vs", "erc", "bi", "fm100", "fm1000", "days_from_ignition")
NUMERIC = (
    *dict.fromkeys((*PRIMITIVES, *BY_NAME, *US_NUMBERS)),
    *VICTORIA_COLUMNS,
    *(f"{name}_historical" for name in VICTORIA_COLUMNS),
)
"""Columns of any training table that hold numbers, by the names that the tables come with."""


def features_of(schema: Schema, groups: tuple[Group, ...] = GROUPS) -> tuple[Feature, ...]:
    """The columns that a schema carries, in the order that the model is trained and asked in."""
    return tuple(f for f in FEATURES if schema in f.carried and f.group in groups)


def single_indices(schema: Schema) -> tuple[Feature, ...]:
    """The single indices that a schema's table carries, to be held against the model."""
    return tuple(f for f in FEATURES if schema in f.carried and f.danger)


def derive(primitives: pd.DataFrame) -> pd.DataFrame:
    """The primitives with every derived column and index added (units in the names); NaN stays NaN.

    Needs temperature_c, relative_humidity_pct, wind_speed_m_s and kbdi_mm (0-203.2; NaN where a table has none). A 10-h
    moisture already there is kept (the time-lag forecast), elsewhere it is Burgan's 1.28 x equilibrium moisture, which
    stands for the same thing.
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
    frame["kbdi_mm"] = drought = physical(drought, "kbdi_mm")
    frame["vpd_hpa"] = indices.vapour_pressure_deficit_hpa(t, rh)
    burgan = indices.fuel_moisture_10h_pct(t, rh)
    given = frame.get("dead_fuel_moisture_10h_pct", pd.Series(np.nan, index=frame.index)).to_numpy(dtype=np.float64)
    frame["dead_fuel_moisture_10h_pct"] = np.where(np.isnan(given), burgan, given)
    frame["ffdi_dry"] = indices.forest_fire_danger(t, rh, wind, indices.drought_factor_dry(drought))
    frame["hdw_surface"] = frame["vpd_hpa"] * wind
    frame["lfp_weather"] = indices.large_fire_potential(wind, t, rh)
    frame["sawti_weather"] = indices.sawti_category(frame["lfp_weather"], 1)
    frame["ffwi"] = indices.fosberg(t, rh, wind)
    frame["ffmc_equilibrium"] = indices.equilibrium_ffmc(t, rh)
    frame["isi_equilibrium"] = indices.initial_spread(frame["ffmc_equilibrium"], wind)
    return frame


def from_victoria(table: pd.DataFrame) -> pd.DataFrame:
    """The Victorian table with our names and units: wind in m/s, derived columns added; labels and season kept.

    Weather is the historical grid's value; where that is missing, the forecast's of the same hour (``T_SFC``, …).
    """
    missing = [f"{name}_historical" for name in VICTORIA_COLUMNS if f"{name}_historical" not in table.columns]
    if missing:
        raise DomainError(f"The table lacks the column '{missing[0]}'.", field=missing[0])
    taken = set(VICTORIA_COLUMNS.values())
    frame = table.drop(columns=[column for column in taken if column in table.columns])
    for name, ours in VICTORIA_COLUMNS.items():
        forecast = table.get(name, pd.Series(np.nan, index=table.index)).astype(np.float64)
        frame[ours] = table[f"{name}_historical"].astype(np.float64).fillna(forecast)
    frame["wind_speed_m_s"] = frame["wind_speed_km_h"] / 3.6
    return derive(frame)


US_REGIONS = {
    "northwest": ("WA", "OR", "ID", "MT", "WY", "AK"),
    "southwest": ("CA", "NV", "AZ", "NM", "UT", "CO", "HI"),
    "plains": ("TX", "OK", "KS", "NE", "SD", "ND", "AR", "LA", "MO", "IA"),
    "southeast": ("FL", "GA", "AL", "MS", "SC", "NC", "TN", "PR"),
}
US_OTHER_REGION = "northeast"
US_LATEST_DAY = 3


def from_us(table: pd.DataFrame) -> pd.DataFrame:
    """The US table (gridMET windows with the ICS-209 outcome) as one row a fire: its first day, day 3 at the latest.

    Hottest hour's temperature (``tmmx``, kelvin) with the lowest humidity of the day and its mean wind; KBDI is not
    there. ``region`` groups states, for tests that leave one region out.
    """
    needed = (*US_NUMBERS, "ics_id", "ics_state")
    missing = [name for name in needed if name not in table.columns]
    if missing:
        raise DomainError(f"The table lacks the column '{missing[0]}'.", field=missing[0], accepted=", ".join(needed))
    early = table[table["days_from_ignition"].between(0, US_LATEST_DAY)]
    order = ["ics_id", "days_from_ignition", *(name for name in ("window_id",) if name in table.columns)]
    first = early.sort_values(order, kind="stable").drop_duplicates("ics_id").reset_index(drop=True)
    state_region = {state: region for region, states in US_REGIONS.items() for state in states}
    region = first["ics_state"].map(state_region).fillna(US_OTHER_REGION)
    named = first.assign(
        temperature_c=first["tmmx"] - 273.15,
        relative_humidity_pct=first["rmin"],
        wind_speed_m_s=first["vs"],
        kbdi_mm=np.nan,
        region=region,
    )
    return derive(named)
