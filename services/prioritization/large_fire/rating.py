"""Rate active fires: how likely each is to grow large, with interval, place among past fires and reasons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import geopandas
import numpy as np
import pandas as pd

from services.prioritization import indices, weather
from services.prioritization.large_fire import features
from services.prioritization.large_fire.model import LargeFireModel
from shared.errors import DomainError

RATED_HOURS = 24
WHOLE_DAY_H = 18
SeriesAt = Callable[[float, float], pd.DataFrame]
"""Hourly weather (time index, contract's columns) at (longitude_deg, latitude_deg); no rows where none is known."""


@dataclass(frozen=True)
class Conditions:
    """One row per fire: the model's primitives at the worst hour, and per fire which of them had to be imputed."""

    table: pd.DataFrame
    imputed: list[list[str]]


def burning_conditions(
    incidents: geopandas.GeoDataFrame,
    series_at: SeriesAt,
    time: pd.Timestamp,
    kbdi_at: Callable[[float, float], float],
    fuel_moisture_at: Callable[[float, float, pd.Timestamp], float],
    median: dict[str, float],
    elevation_at: Callable[[float, float], float] = lambda longitude, latitude: float("nan"),
) -> Conditions:
    """Weather of each fire at the worst hour (largest dry-limit FFDI) of the 24 h after ``time``.

    Where weather or KBDI is unknown the training median stands in and is named: unknown is neither zero nor safe.
    ``elevation_at`` (m, NaN where unknown) serves only to find the past fires that a fire is compared with.
    """
    rows, imputed = [], []
    for place in incidents.geometry.representative_point():
        drought = kbdi_at(place.x, place.y)
        row = _worst_hour(series_at(place.x, place.y), time, median["kbdi_mm"] if np.isnan(drought) else drought)
        row["kbdi_mm"] = drought
        row["dead_fuel_moisture_10h_pct"] = fuel_moisture_at(place.x, place.y, row.pop("hour"))
        gaps = [name for name in features.PRIMITIVES if not np.isfinite(row[name])]
        row.update({name: median[name] for name in gaps})
        row["elevation_m"] = elevation_at(place.x, place.y)
        row["known_kbdi_mm"] = drought
        rows.append(row)
        imputed.append(gaps)
    columns = [*features.PRIMITIVES, "dead_fuel_moisture_10h_pct", "elevation_m", "known_kbdi_mm"]
    return Conditions(pd.DataFrame(rows, columns=columns, dtype=np.float64), imputed)


def carried_drought(
    kbdi_mm: float, annual_rain_mm: float, series: pd.DataFrame, since: pd.Timestamp, time: pd.Timestamp
) -> float:
    """KBDI (mm) at ``time`` from that at ``since``, over the whole days between for which hourly weather is there."""
    past = series[(series.index > since) & (series.index <= time)].dropna(subset=["temperature_c", "rain_mm"])
    day = ((past.index - since) / pd.Timedelta(days=1)).to_numpy()
    past = past.assign(day=np.ceil(day - 1e-9).astype(int))
    daily = past.groupby("day").agg(
        rain=("rain_mm", "sum"), hottest=("temperature_c", "max"), hours=("rain_mm", "size")
    )
    daily = daily[daily["hours"] >= WHOLE_DAY_H]
    if daily.empty or np.isnan(kbdi_mm) or np.isnan(annual_rain_mm):
        return kbdi_mm
    values, _ = indices.kbdi(daily["rain"].to_numpy(), daily["hottest"].to_numpy(), annual_rain_mm, kbdi_mm)
    return float(values.ravel()[-1])


def _worst_hour(series: pd.DataFrame, time: pd.Timestamp, kbdi_mm: float) -> dict[str, float | pd.Timestamp]:
    names = ("temperature_c", "relative_humidity_pct", "wind_speed_m_s")
    ahead = series[(series.index > time) & (series.index <= time + pd.Timedelta(hours=RATED_HOURS))]
    whole = ahead.dropna(subset=list(names))
    if len(whole) < weather.MIN_HOURS:
        return {**dict.fromkeys(names, np.nan), "hour": time}
    danger = indices.forest_fire_danger(
        whole["temperature_c"],
        whole["relative_humidity_pct"],
        whole["wind_speed_m_s"],
        indices.drought_factor_dry(kbdi_mm),
    )
    worst = int(np.argmax(danger))
    return {**{name: float(whole[name].iloc[worst]) for name in names}, "hour": whole.index[worst]}


def rate(
    incidents: geopandas.GeoDataFrame, conditions: Conditions, model: LargeFireModel, time: pd.Timestamp
) -> pd.DataFrame:
    """Ratings of the contract, one row per incident in the incidents' order, the model's inputs as further columns.

    ``percentile`` is among the training fires of the same kind of place and season (``compared_with``).

    DomainError if the model asks for columns that the loop cannot supply (one of the ``full`` schema).
    """
    if model.calibration.schema != "loop":
        raise DomainError(
            "This model needs land and fuel columns that incidents and weather do not carry.",
            field="model",
            value=model.calibration.schema,
            accepted="a model of the 'loop' schema",
        )
    frame = features.derive(conditions.table)
    margin = model.margin(frame)
    probability, low, high = model.calibration.probability(margin)
    contributions = model.contributions(frame)
    outside = [_outside_training(frame.iloc[i], model) for i in range(len(frame))]
    past = model.calibration.groups
    kinds = [past.group(row.known_kbdi_mm, row.elevation_m) for row in conditions.table.itertuples()]
    ratings = pd.DataFrame(
        {
            "incident_id": incidents["incident_id"].to_numpy(),
            "time": time,
            "probability": probability,
            "probability_low": low,
            "probability_high": high,
            "percentile": [past.percentile(m, kind) for m, kind in zip(margin, kinds, strict=True)],
            "drivers": [_drivers(frame.iloc[i], contributions[i], model) for i in range(len(frame))],
            "out_of_domain": [bool(names) for names in outside],
            "imputed": [",".join(names) for names in conditions.imputed],
            "outside_training": [",".join(names) for names in outside],
            "compared_with": [f"{past.fires[kind]} past fires: {kind}" for kind in kinds],
        }
    )
    shown = [*features.PRIMITIVES, "dead_fuel_moisture_10h_pct", "ffdi_dry", "ffwi", "lfp_weather", "hdw_surface"]
    return pd.concat([ratings, frame[shown].reset_index(drop=True)], axis=1)


def _drivers(row: pd.Series, contribution: np.ndarray, model: LargeFireModel, count: int = 3) -> str:
    """The three strongest parts of the margin, in words: value with unit, and what it adds to the log odds."""
    strongest = np.argsort(-np.abs(contribution), kind="stable")[:count]
    texts = []
    for index in strongest:
        feature = model.features[index]
        unit = f" {feature.unit}" if feature.unit else ""
        texts.append(f"{feature.label} {row[feature.name]:.3g}{unit} ({contribution[index]:+.2f})")
    return ", ".join(texts)


def _outside_training(row: pd.Series, model: LargeFireModel) -> list[str]:
    """Features beyond the 0.1-99.9 % span of the training fires."""
    low, high = model.calibration.low, model.calibration.high
    return [f.name for f in model.features if not low[f.name] <= row[f.name] <= high[f.name]]
