"""The linear half of the model: logistic regression on physical terms, with the few products that fire physics names.

Trees see each column and find steps; with a few hundred large fires they cannot be sure of a slope or of a product.
The regression supplies those: logs of indices (their effect is multiplicative), cover, distance to people, and index
times cover (the same danger index means another fire in heath than in pasture).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization.large_fire.features import BY_NAME

Array = npt.NDArray[np.float64]

INVERSE_PENALTY = 0.1
"""C of the ridge penalty on standardised terms."""


def _log(values: Array) -> Array:
    return np.log(np.maximum(values, 1e-3))


def _log1p(values: Array) -> Array:
    return np.log1p(np.maximum(values, 0))


def _root(values: Array) -> Array:
    return np.sqrt(np.maximum(values, 0))


def _same(values: Array) -> Array:
    return values


@dataclass(frozen=True)
class Term:
    """A term: the product of its columns, each through its transform."""

    columns: tuple[str, ...]
    transforms: tuple[Callable[[Array], Array], ...]

    @property
    def name(self) -> str:
        return " x ".join(self.columns)

    def values(self, frame: pd.DataFrame) -> Array:
        """The term of each row, NaN where a column is."""
        parts = [
            transform(frame[column].to_numpy(dtype=np.float64))
            for column, transform in zip(self.columns, self.transforms, strict=True)
        ]
        return np.prod(parts, axis=0)


def _one(transform: Callable[[Array], Array], *columns: str) -> list[Term]:
    return [Term((column,), (transform,)) for column in columns]


TERMS = (
    *_one(_log, "ffdi_dry", "ffdi"),
    *_one(_log1p, "gfdi", "lfp_weather", "isi_equilibrium", "hdw_surface"),
    *_one(_root, "ffwi"),
    *_one(_same, "kbdi_mm", "sawti_weather", "ffmc_equilibrium", "erc", "bi", "fm100", "fm1000"),
    *_one(_same, "temperature_c", "relative_humidity_pct", "wind_speed_m_s", "vpd_hpa"),
    *_one(_same, "dead_fuel_moisture_10h_pct", "soil_moisture", "drought_factor", "curing_pct"),
    *_one(_same, "grass_density_3km", "forest_density_3km", "noveg_density_3km", "elevation_m"),
    *_one(_root, "shrub_density_3km"),
    *_one(_log1p, "distance_to_interface", "ruggedness_average_3km", "building_density_3km", "building_density_20km"),
    *_one(_log1p, "road_density_km_in_3km", "road_distance_m"),
    Term(("ffdi", "shrub_density_3km"), (_log, _root)),
    Term(("ffdi", "forest_density_3km"), (_log, _same)),
    Term(("gfdi", "grass_density_3km"), (_log1p, _same)),
)


@dataclass(frozen=True)
class LinearPart:
    """Coefficients on standardised terms; a missing term counts as its training mean."""

    terms: list[str]
    mean: list[float]
    scale: list[float]
    coefficient: list[float]
    intercept: float

    def standardised(self, frame: pd.DataFrame) -> Array:
        """Standardised terms (rows, terms) of a frame that holds the columns."""
        by_name = {term.name: term for term in TERMS}
        values = np.stack([by_name[name].values(frame) for name in self.terms], axis=1)
        return np.nan_to_num((values - np.asarray(self.mean)) / np.asarray(self.scale))

    def margin(self, frame: pd.DataFrame) -> Array:
        """Log odds of each row."""
        return self.standardised(frame) @ np.asarray(self.coefficient) + self.intercept

    def contributions(self, frame: pd.DataFrame, names: list[str]) -> Array:
        """Each named column's part of the log odds against the average fire; a product's is shared by its columns."""
        parts = self.standardised(frame) * np.asarray(self.coefficient)
        by_name = {term.name: term for term in TERMS}
        out = np.zeros((len(frame), len(names)))
        for index, name in enumerate(self.terms):
            columns = by_name[name].columns
            for column in columns:
                out[:, names.index(column)] += parts[:, index] / len(columns)
        return out


def fit(frame: pd.DataFrame, label: Array, names: list[str]) -> LinearPart:
    """Ridge logistic regression on every term whose columns are among ``names``."""
    terms = [term for term in TERMS if set(term.columns) <= set(names)]
    values = np.stack([term.values(frame) for term in terms], axis=1)
    mean, scale = np.nanmean(values, axis=0), np.nanstd(values, axis=0)
    scale = np.where(scale > 1e-12, scale, 1.0)
    standardised = np.nan_to_num((values - mean) / scale)
    coefficient, intercept = _ridge(standardised, label, [_sign(term) for term in terms])
    return LinearPart(
        [term.name for term in terms],
        [float(v) for v in mean],
        [float(v) for v in scale],
        [float(v) for v in coefficient],
        intercept,
    )


def _sign(term: Term) -> int:
    """Sign that physics gives a term's coefficient: that of its column; a product's and land's is free."""
    return BY_NAME[term.columns[0]].sign if len(term.columns) == 1 else 0


def _ridge(values: Array, label: Array, signs: list[int]) -> tuple[Array, float]:
    """Coefficients and intercept of the least penalised log loss under the signs (L-BFGS-B)."""
    from scipy.optimize import minimize

    def loss(beta: Array) -> tuple[float, Array]:
        margin = values @ beta[:-1] + beta[-1]
        error = 1 / (1 + np.exp(-np.clip(margin, -35, 35))) - label
        value = np.logaddexp(0, margin).sum() - label @ margin + 0.5 / INVERSE_PENALTY * (beta[:-1] ** 2).sum()
        return float(value), np.append(values.T @ error + beta[:-1] / INVERSE_PENALTY, error.sum())

    rate = float(np.clip(label.mean(), 1e-6, 1 - 1e-6))
    begin = np.append(np.zeros(values.shape[1]), np.log(rate / (1 - rate)))
    bounds = [(0.0, None) if sign > 0 else (None, 0.0) if sign < 0 else (None, None) for sign in signs]
    found = minimize(
        loss, begin, jac=True, method="L-BFGS-B", bounds=[*bounds, (None, None)], options={"maxiter": 2000}
    )
    return found.x[:-1], float(found.x[-1])
