"""Refit of WFSP and WLFP: penalised logistic regression with smooth terms in place, day and WFPI.

``fit`` needs two tables. Fires: one row an ignition of an acre or more, with place, time, WFPI of that day and its
final area. Voxels: km2-days with place, time, WFPI, whether a fire was lit in them, and the rate at which they were
sampled (1 for ignitions, some millionths for the rest: log(1 / rate) corrects the intercept, King & Zeng 2001).
Penalties: second differences of the spline coefficients (Eilers & Marx 1996), a stiff one on falling WFPI terms
(Bollaerts et al. 2006), their weight by AIC. ``reliability`` holds leave-one-year-out predictions against the USGS.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.interpolate import BSpline

from services.prioritization import plain_columns
from services.prioritization.prefire import fire_probability
from services.prioritization.prefire.fire_probability import FireProbability, PlaceTerm, SmoothLogit
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

PLACES = (9, 6)
WFPI_SPLINES, WFPI_HIGH = 8, 160.0
DAY_TERMS = 4
PENALTIES = (0.3, 3.0, 30.0)
RIDGE = 1e-3
STIFF = 1e6
ITERATIONS = 40
MIN_EVENTS = 20
FIRE_COLUMNS = ("longitude_deg", "latitude_deg", "time", "wfpi", "large")
VOXEL_COLUMNS = ("longitude_deg", "latitude_deg", "time", "wfpi", "ignition", "sampling_rate")


@dataclass(frozen=True)
class Box:
    """The domain of the place term, degrees."""

    west: float
    south: float
    east: float
    north: float


def box_of(*tables: pd.DataFrame) -> Box:
    """The box around all places, 2 degrees wider."""
    joined = pd.concat([table[["longitude_deg", "latitude_deg"]] for table in tables])
    low, high = joined.min() - 2.0, joined.max() + 2.0
    return Box(*(round(float(v), 3) for v in (*low, *high)))


def design(table: pd.DataFrame, box: Box) -> Array:
    """The matrix (rows, coefficients): intercept, place (longitude by latitude), day, WFPI."""
    east = _splines(table["longitude_deg"].to_numpy(float), box.west, box.east, PLACES[0])
    north = _splines(table["latitude_deg"].to_numpy(float), box.south, box.north, PLACES[1])
    place = (east[:, :, None] * north[:, None, :]).reshape(len(table), -1)
    half_a_year = np.where(table["latitude_deg"] < 0, fire_probability.YEAR_D / 2, 0.0)
    day = fire_probability.day_terms(table["time"].dt.dayofyear.to_numpy(float) + half_a_year)
    wfpi = _splines(np.minimum(table["wfpi"].to_numpy(float), WFPI_HIGH), 0.0, WFPI_HIGH, WFPI_SPLINES)
    return np.concatenate([np.ones((len(table), 1)), place, day, wfpi], axis=1)


def _splines(values: Array, low: float, high: float, count: int) -> Array:
    knots = fire_probability.uniform_knots(low, high, count)
    return BSpline.design_matrix(np.clip(values, low, high), knots, 3).toarray()


def _penalty(weight: float) -> Array:
    """Roughness of every smooth term, (coefficients, coefficients)."""
    east, north = PLACES
    rough_e, rough_n, rough_w = (np.diff(np.eye(count), 2, axis=0) for count in (east, north, WFPI_SPLINES))
    place = np.kron(rough_e.T @ rough_e, np.eye(north)) + np.kron(np.eye(east), rough_n.T @ rough_n)
    size = 1 + east * north + DAY_TERMS + WFPI_SPLINES
    matrix = RIDGE * np.eye(size)
    matrix[0, 0] = 1e-9
    first = 1 + east * north
    matrix[1:first, 1:first] += weight * (place + 0.1 * np.eye(east * north))
    matrix[first + 2 : first + DAY_TERMS, first + 2 : first + DAY_TERMS] += weight * np.eye(2)
    matrix[-WFPI_SPLINES:, -WFPI_SPLINES:] += weight * rough_w.T @ rough_w
    return matrix


def _falling(coefficients: Array) -> Array:
    """The stiff penalty where the WFPI term falls."""
    steps = np.diff(np.eye(WFPI_SPLINES), axis=0)
    active = (steps @ coefficients[-WFPI_SPLINES:] < 0).astype(float)
    matrix = np.zeros((len(coefficients), len(coefficients)))
    matrix[-WFPI_SPLINES:, -WFPI_SPLINES:] = STIFF * steps.T @ (active[:, None] * steps)
    return matrix


@dataclass(frozen=True)
class Fitted:
    """Coefficients, and AIC with the effective number of them."""

    coefficients: Array
    aic: float


def regress(matrix: Array, outcome: Array, offset: Array, weight: float, start: Array | None = None) -> Fitted:
    """Penalised logistic regression by iteratively reweighted least squares (Newton's method), from ``start``."""
    rough = _penalty(weight)
    share = float(np.clip(outcome.mean(), 1e-6, 1 - 1e-6))
    coefficients = np.zeros(matrix.shape[1]) if start is None else start
    if start is None:
        coefficients[0] = np.log(share / (1 - share)) - float(offset.mean())
    for _ in range(ITERATIONS):
        probability = fire_probability.sigmoid(matrix @ coefficients + offset)
        spread = np.maximum(probability * (1 - probability), 1e-10)
        stiff = rough + _falling(coefficients)
        curvature = matrix.T @ (spread[:, None] * matrix)
        gradient = matrix.T @ (outcome - probability) - stiff @ coefficients
        step = np.linalg.solve(curvature + stiff, gradient)
        step *= min(1.0, 5.0 / max(float(np.abs(matrix @ step).max()), 1e-9))
        coefficients = coefficients + step
        if np.abs(step).max() < 1e-6:
            break
    probability = np.clip(fire_probability.sigmoid(matrix @ coefficients + offset), 1e-12, 1 - 1e-12)
    deviance = -2 * float(np.sum(outcome * np.log(probability) + (1 - outcome) * np.log1p(-probability)))
    effective = float(np.trace(np.linalg.solve(curvature + stiff, curvature)))
    return Fitted(coefficients, deviance + 2 * effective)


def fit_logit(
    table: pd.DataFrame, outcome: str, box: Box, penalties: tuple[float, ...] = PENALTIES
) -> tuple[SmoothLogit, float]:
    """The regression of least AIC and its penalty. ``sampling_rate``, where there is one, corrects for the sampling.

    A voxel drawn at rate r stands for 1 / r voxels: with ignitions all kept, the sample's odds are the truth's divided
    by r, so the fit takes -log(r) as an offset that the model then leaves out.
    """
    events = table[outcome].to_numpy(float)
    if min(events.sum(), (1 - events).sum()) < MIN_EVENTS:
        raise DomainError(
            f"'{outcome}' is 1 in {int(events.sum())} of {len(events)} rows: too few of either kind to fit.",
            field=outcome,
            value=int(events.sum()),
            accepted=f"at least {MIN_EVENTS} rows of each kind",
        )
    offset = sampling_offset(table, outcome)
    matrix = design(table, box)
    tried: list[tuple[Fitted, float]] = []
    for weight in penalties:
        start = tried[-1][0].coefficients if tried else None
        tried.append((regress(matrix, events, offset, weight, start), weight))
    best, weight = min(tried, key=lambda pair: pair[0].aic)
    return _model(best, box), weight


def sampling_offset(table: pd.DataFrame, outcome: str) -> Array:
    """-log(rate) at which the rows without the outcome were sampled, for every row; 0 where all were kept."""
    if "sampling_rate" not in table:
        return np.zeros(len(table))
    return np.full(len(table), -np.log(float(table.loc[table[outcome] == 0, "sampling_rate"].iloc[0])))


def _model(fitted: Fitted, box: Box) -> SmoothLogit:
    values = fitted.coefficients
    first = 1 + PLACES[0] * PLACES[1]
    place = values[1:first].reshape(PLACES)
    return SmoothLogit(
        intercept=float(values[0]),
        place=PlaceTerm(box.west, box.south, box.east, box.north, _rows(place)),
        day=tuple(map(float, values[first : first + DAY_TERMS])),
        wfpi=tuple(map(float, values[-WFPI_SPLINES:])),
        wfpi_high=WFPI_HIGH,
    )


def _rows(matrix: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(f"{value:.7g}") for value in row) for row in matrix)


@dataclass(frozen=True)
class Refit:
    """A fitted model and the penalties that AIC chose for its two regressions."""

    model: FireProbability
    spread_penalty: float
    ignition_penalty: float


def fit(fires: pd.DataFrame, voxels: pd.DataFrame, trained_on: str, demonstration: bool = False) -> Refit:
    """Both regressions from checked tables (``checked_fires``, ``checked_voxels``)."""
    box = box_of(fires, voxels)
    spread, spread_penalty = fit_logit(fires, "large", box)
    ignition, ignition_penalty = fit_logit(voxels, "ignition", box)
    return Refit(FireProbability(spread, ignition, trained_on, demonstration), spread_penalty, ignition_penalty)


def read_table(path: Path, name: str) -> pd.DataFrame:
    """A table of Parquet or CSV; DomainError if it is neither."""
    try:
        return pd.read_parquet(path) if path.read_bytes()[:4] == b"PAR1" else pd.read_csv(path)
    except (ValueError, OSError, EOFError) as error:
        message = f"The table of {name} cannot be read: {error}"
        raise DomainError(message, field=name, accepted="Parquet or CSV") from error


def checked_fires(table: pd.DataFrame) -> pd.DataFrame:
    """Fires with ``large`` (from ``area_km2`` where only that is given: over 500 acres), times in UTC."""
    if "large" not in table and "area_km2" in table:
        area_km2 = plain_columns.numbers(table, "area_km2", "area_km2")
        table = table.assign(large=(area_km2 > fire_probability.LARGE_FIRE_KM2).astype(int))
    return _checked(table, FIRE_COLUMNS, "fires", "large")


def checked_voxels(table: pd.DataFrame) -> pd.DataFrame:
    """Voxels: those without a fire share one sampling rate in (0, 1]; times in UTC."""
    checked = _checked(table, VOXEL_COLUMNS, "voxels", "ignition")
    rates = checked.loc[checked["ignition"] == 0, "sampling_rate"].unique()
    if len(rates) != 1 or not 0 < rates[0] <= 1:
        raise DomainError(
            "Voxels without a fire must all have been sampled at one rate.",
            field="sampling_rate",
            value=str(rates[:3].tolist()),
            accepted="one rate above 0 and at most 1",
        )
    return checked


def _checked(table: pd.DataFrame, columns: tuple[str, ...], name: str, outcome: str) -> pd.DataFrame:
    missing = [column for column in columns if column not in table]
    if missing:
        raise DomainError(
            f"The table of {name} lacks '{missing[0]}'.", field=name, value=missing[0], accepted=", ".join(columns)
        )
    kept = [*columns, *(["large"] if "large" in table and "large" not in columns else [])]
    numeric = {column: plain_columns.numbers(table, column, column) for column in kept if column != "time"}
    checked = table[["time"]].assign(time=plain_columns.times(table, "time", "time"), **numeric)[kept]
    limits = {"longitude_deg": 360, "latitude_deg": 90, "wfpi": fire_probability.WFPI_LARGEST}
    for column, limit in limits.items():
        values = checked[column].to_numpy(float)
        low = 0 if column == "wfpi" else -limit
        _refuse(name, column, ~((values >= low) & (values <= limit)), values, f"{low}..{limit}")
    _refuse(name, outcome, ~checked[outcome].isin([0, 1]).to_numpy(), checked[outcome].to_numpy(), "0 or 1")
    return checked.reset_index(drop=True)


def _refuse(name: str, column: str, bad: npt.NDArray[np.bool_], values: Any, accepted: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise DomainError(
            f"Row {row} of the {name} has {column} {values[row]}.", field=column, value=values[row], accepted=accepted
        )


def coefficients_of(model: SmoothLogit) -> Array:
    """The coefficients in the order of ``design``."""
    place = np.array(model.place.coefficients).ravel()
    return np.concatenate([[model.intercept], place, model.day, model.wfpi])
