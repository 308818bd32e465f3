"""Soil moisture of raw-IF looks: what the map adds to the cell's regression, by quantiles with conformal intervals.

The model predicts the departure of soil moisture from the regression's estimate. Conformalised quantile regression
(Romano, Patterson and Candes 2019) with XGBoost by default; NGBoost (Duan et al. 2020) as an option, conformal too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
import xgboost as xgb
from numpy.typing import NDArray

from services.retrieval.looks.features import SHAPE_FEATURES, STRENGTH_FEATURES, TEXTURE_FEATURES
from services.retrieval.soil_moisture.boosted_normal import BoostedNormal, fit_boosted_normal
from services.retrieval.soil_moisture.conformal import grouped_quantile, site_folds
from services.retrieval.ubj import is_whole_object
from shared.errors import DomainError

FloatArray = NDArray[np.float64]

CELL_FEATURES = ("soil_moisture_mean", "anomaly_db", "count")
FEATURES = (*CELL_FEATURES, *STRENGTH_FEATURES, *SHAPE_FEATURES, *TEXTURE_FEATURES)
QUANTILES = (0.05, 0.5, 0.95)
# Wetter soil reflects more: what rises with reflectivity never lowers the departure, and the regression's estimate that
# it is added to rises by itself. The estimate is no feature, for a departure that fell with it could outweigh it.
RISING = ("anomaly_db", "reflectivity_db", "snr_db")
PARAMETERS = {
    "objective": "reg:quantileerror",
    "quantile_alpha": np.array(QUANTILES),
    "tree_method": "hist",
    "max_depth": 3,
    "eta": 0.1,
    "min_child_weight": 20,
    "subsample": 0.8,
    "colsample_bytree": 0.7,
    "lambda": 4.0,
}
ROUNDS = 60
FOLDS = 5
MIN_ROWS, MIN_SITES = 100, 10


class Spread(Protocol):
    """A fitted model of a departure: its lower bound, middle and upper bound, widened by the conformal ``margin``."""

    def score(self, table: FloatArray, departure: FloatArray) -> FloatArray: ...

    def bounds(self, table: FloatArray, margin: float) -> FloatArray: ...


@dataclass(frozen=True)
class Quantiles:
    """A booster of three quantiles."""

    booster: xgb.Booster

    def _raw(self, table: FloatArray) -> FloatArray:
        found = self.booster.predict(xgb.DMatrix(table.astype(np.float32), nthread=1)).astype(np.float64)
        return np.sort(found.reshape(len(table), len(QUANTILES)), axis=1)

    def score(self, table: FloatArray, departure: FloatArray) -> FloatArray:
        """How far beyond the interval (negative: within) each departure lies, (n,)."""
        low, _, high = self._raw(table).T
        return np.maximum(low - departure, departure - high)

    def bounds(self, table: FloatArray, margin: float) -> FloatArray:
        """Lower bound, median, upper bound (n, 3)."""
        low, middle, high = self._raw(table).T
        low, high = low - margin, high + margin
        centre = (low + high) / 2.0
        low, high = np.minimum(low, centre), np.maximum(high, centre)
        return np.stack([low, np.clip(middle, low, high), high], axis=1)


@dataclass(frozen=True)
class RawIfModel:
    """A spread and its conformal margin; ``method`` is ``cqr`` or ``ngboost``."""

    method: str
    spread: Spread
    margin: float

    @property
    def file_name(self) -> str:
        return "raw_if_model.ubj" if self.method == "cqr" else "raw_if_model.json"

    def interval(self, table: pd.DataFrame) -> FloatArray:
        """Lower bound of the 90 % interval, estimate, upper bound of soil moisture (m3/m3, unclipped), (n, 3)."""
        if not len(table):
            return np.empty((0, 3))
        values = table[list(FEATURES)].to_numpy(np.float64)
        return table["estimate"].to_numpy()[:, None] + self.spread.bounds(values, self.margin)

    def save(self, path: str | Path, attributes: Mapping[str, Any]) -> None:
        """UBJ (cqr) or JSON (ngboost), with features, margin and product attributes."""
        notes = {"method": self.method, "margin": repr(self.margin), "features": json.dumps(list(FEATURES))}
        notes["product"] = json.dumps(dict(attributes), sort_keys=True)
        if isinstance(self.spread, Quantiles):
            self.spread.booster.set_attr(**notes)
            Path(path).write_bytes(bytes(self.spread.booster.save_raw(raw_format="ubj")))
        elif isinstance(self.spread, BoostedNormal):
            document = {**notes, "trees": self.spread.as_document()}
            Path(path).write_text(json.dumps(document, sort_keys=True), encoding="utf-8")


def train_raw_if(table: pd.DataFrame, site: NDArray, method: str = "cqr", seed: int = 0) -> RawIfModel:
    """Train on cell-days with FEATURES and ``soil_moisture``; calibrate on sites that the fold's model has not seen.

    DomainError with fewer than 100 cell-days or 10 sites. The same inputs give the same bytes.
    """
    sites = np.unique(site).size
    if len(table) < MIN_ROWS or sites < MIN_SITES:
        raise DomainError(
            f"{len(table)} raw-IF cell-days of {sites} sites are too few.",
            field="observations",
            accepted=f"at least {MIN_ROWS} of {MIN_SITES} sites",
        )
    values = table[list(FEATURES)].to_numpy(np.float64)
    departure = (table["soil_moisture"] - table["estimate"]).to_numpy(np.float64)
    fit = {"cqr": _fit_quantiles, "ngboost": fit_boosted_normal}[method]
    fold = site_folds(site, FOLDS)
    score = np.empty(len(table))
    for held in range(FOLDS):
        away = fold == held
        score[away] = fit(values[~away], departure[~away], seed).score(values[away], departure[away])
    return RawIfModel(method, fit(values, departure, seed), grouped_quantile(score, site))


def _fit_quantiles(values: FloatArray, departure: FloatArray, seed: int) -> Quantiles:
    rising = tuple(int(name in RISING) for name in FEATURES)
    data = xgb.DMatrix(values.astype(np.float32), label=departure.astype(np.float32), nthread=1)
    settings = {**PARAMETERS, "monotone_constraints": rising, "nthread": 1, "seed": seed}
    return Quantiles(xgb.train(settings, data, num_boost_round=ROUNDS))


def load_raw_if(path: str | Path) -> RawIfModel:
    """Read what ``RawIfModel.save`` wrote; DomainError where the file is no such model."""
    content = Path(path).read_bytes()
    try:
        if content[:2] == b'{"':
            document = json.loads(content)
            return RawIfModel("ngboost", BoostedNormal.from_document(document["trees"]), float(document["margin"]))
        if not (is_whole_object(content) and b"quantileerror" in content):
            raise ValueError("no whole UBJ model of quantiles")
        booster = xgb.Booster(params={"nthread": 1}, model_file=bytearray(content))
        if json.loads(booster.attr("features") or "[]") != list(FEATURES):
            raise ValueError("other features")
        return RawIfModel("cqr", Quantiles(booster), float(booster.attr("margin") or ""))
    except (ValueError, KeyError, TypeError, IndexError, xgb.core.XGBoostError) as error:
        raise DomainError(
            f"'{Path(path).name}' is no soil-moisture model of raw-IF looks: {str(error).splitlines()[0]}",
            field="raw_if_model",
            accepted="a file written by train-soil-moisture",
        ) from error
