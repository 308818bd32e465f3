"""From WFPI to probabilities: WFSP (a fire, once lit, exceeds 500 acres) and WLFP (large fires per area and day).

Form, as the USGS describes its own ("the historic average of place and day, adjusted by the WFPI of that day"): two
logistic regressions, each with smooth terms,

    logit P = b + s(longitude, latitude) + s(day of the year) + s(WFPI).

WFSP is P(over 500 acres | an ignition of an acre), in per cent. WLFP = 10^6 P(ignition in a km2 and day) x WFSP / 100,
expected large fires per million km2 and day. Place: a tensor product of cubic B-splines; day: a yearly cycle of two
harmonics, half a year later in the south; WFPI: cubic B-splines that never fall. The coefficients come from a refit
(``fire_probability_fit``). Those shipped were refitted to a SIMULATED fire history: a demonstration, to be replaced.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from services.prioritization.prefire.conditions import Blend
from shared.errors import ContractError

Array = npt.NDArray[np.floating[Any]]

LARGE_FIRE_KM2 = 500 * 0.00404685642
WFPI_LARGEST = 247
_DEGREE = 3
YEAR_D = 365.25
_WFPI_TABLE = np.arange(WFPI_LARGEST + 1.0)


@dataclass(frozen=True)
class PlaceTerm:
    """Tensor B-splines (longitude, latitude) over a box in degrees; 0, the average place, outside it."""

    west: float
    south: float
    east: float
    north: float
    coefficients: tuple[tuple[float, ...], ...]

    def __call__(self, longitude_deg: Array, latitude_deg: Array, kind: Any = np.float64) -> Array:
        """The term at places that broadcast, between values tabulated every tenth of a degree."""
        axes = [_axis(low, high) for low, high in ((self.south, self.north), (self.west, self.east))]
        found = Blend(*axes, np.asarray(latitude_deg), np.asarray(longitude_deg), kind)(self._table(*axes))
        return np.where(self.holds(longitude_deg, latitude_deg), found, kind(0))

    def _table(self, latitude_deg: Array, longitude_deg: Array) -> Array:
        """Values (latitude, longitude) on axes: splines along one axis, then along the other."""
        table = np.array(self.coefficients)
        knots = uniform_knots(self.west, self.east, table.shape[0])
        along = BSpline(knots, table, _DEGREE)(np.clip(longitude_deg, self.west, self.east))
        knots = uniform_knots(self.south, self.north, table.shape[1])
        return BSpline(knots, along.T, _DEGREE)(np.clip(latitude_deg, self.south, self.north))

    def holds(self, longitude_deg: Array, latitude_deg: Array) -> npt.NDArray[np.bool_]:
        """Whether places lie in the box."""
        across = (longitude_deg >= self.west) & (longitude_deg <= self.east)
        return across & (latitude_deg >= self.south) & (latitude_deg <= self.north)


@dataclass(frozen=True)
class SmoothLogit:
    """One regression: intercept, terms of place, day (cosine and sine of one and two cycles a year) and WFPI.

    ``wfpi`` are B-spline coefficients on even knots from 0 to ``wfpi_high``; beyond it the term stays level.
    """

    intercept: float
    place: PlaceTerm
    day: tuple[float, ...]
    wfpi: tuple[float, ...]
    wfpi_high: float

    def yearly(self, latitude_deg: Array, day_of_year: float) -> Array:
        """The term of the day, half a year later in the south."""
        north = day_terms(np.array(day_of_year)) @ np.array(self.day)
        south = day_terms(np.array(day_of_year + YEAR_D / 2)) @ np.array(self.day)
        return np.where(np.asarray(latitude_deg) < 0, south, north)

    def adjustment(self, wfpi: Array) -> Array:
        """What WFPI adds, tabulated at whole WFPI; NaN where WFPI is unknown."""
        knots = uniform_knots(0.0, self.wfpi_high, len(self.wfpi))
        table = BSpline(knots, np.array(self.wfpi), _DEGREE)(np.minimum(_WFPI_TABLE, self.wfpi_high))
        return np.interp(wfpi, _WFPI_TABLE, np.maximum.accumulate(table)).astype(wfpi.dtype)


@dataclass(frozen=True)
class FireProbability:
    """The two regressions and where their coefficients are from."""

    spread: SmoothLogit
    ignition: SmoothLogit
    trained_on: str
    demonstration: bool = True

    def at(self, longitude_deg: Array, latitude_deg: Array) -> ProbabilityAt:
        """The model at places that broadcast to (y, x), whose terms are found once for all days and WFPI."""
        terms = [part.intercept + part.place(longitude_deg, latitude_deg) for part in (self.spread, self.ignition)]
        return ProbabilityAt(self, terms[0], terms[1], np.asarray(latitude_deg))


@dataclass(frozen=True)
class ProbabilityAt:
    """A model with the average logits of fixed places."""

    model: FireProbability
    spread: Array
    ignition: Array
    latitude_deg: Array

    def rates(self, wfpi: Array, day_of_year: float) -> tuple[Array, Array]:
        """WFSP in per cent and WLFP per million km2 and day of WFPI (..., y, x); NaN where it is unknown."""
        parts = ((self.model.spread, self.spread), (self.model.ignition, self.ignition))
        spread, ignition = (
            sigmoid((place + part.yearly(self.latitude_deg, day_of_year)).astype(wfpi.dtype) + part.adjustment(wfpi))
            for part, place in parts
        )
        return 100 * spread, 1e6 * ignition * spread


def _axis(low: float, high: float) -> Array:
    return np.linspace(low, high, int(np.ceil((high - low) / 0.1)) + 1)


def sigmoid(logit: Array) -> Array:
    """1 / (1 + exp(-x)) without overflow."""
    return 1 / (1 + np.exp(-np.clip(logit, -60, 60)))


def uniform_knots(low: float, high: float, count: int) -> Array:
    """Even knots of ``count`` cubic B-splines that are whole on low..high."""
    step = (high - low) / (count - _DEGREE)
    return low + step * np.arange(-_DEGREE, count + 1)


def day_terms(day_of_year: Array) -> Array:
    """Cosine and sine of one and of two cycles a year, (..., 4)."""
    angle = 2 * np.pi * np.asarray(day_of_year, dtype=np.float64)[..., None] / YEAR_D
    return np.concatenate([np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=-1)


def to_document(model: FireProbability) -> dict[str, Any]:
    """The model as JSON."""
    return {"kind": "wlfp-wfsp-smooth-logistic", "version": 1, **asdict(model)}


def from_document(document: Any) -> FireProbability:
    """The model of a JSON document; ContractError if it is none."""
    try:
        if document["kind"] != "wlfp-wfsp-smooth-logistic" or document["version"] != 1:
            raise KeyError("kind")
        logits = [_logit(document[name]) for name in ("spread", "ignition")]
        return FireProbability(*logits, str(document["trained_on"]), bool(document["demonstration"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ContractError(
            f"This is no model of large-fire probability: {error}",
            field="probability_model",
            accepted="the model of fit-fire-probability",
        ) from error


def _logit(part: dict[str, Any]) -> SmoothLogit:
    rows = tuple(tuple(map(float, row)) for row in part["place"]["coefficients"])
    place = PlaceTerm(**{**part["place"], "coefficients": rows})
    rest = {name: tuple(map(float, part[name])) for name in ("day", "wfpi")}
    return SmoothLogit(float(part["intercept"]), place, **rest, wfpi_high=float(part["wfpi_high"]))


def shipped_path() -> Path:
    """The demonstration coefficients that come with the service."""
    return Path(__file__).parent.parent / "models" / "fire_probability_demonstration.json"


@lru_cache(maxsize=1)
def shipped() -> FireProbability:
    """The model at ``shipped_path``."""
    return from_document(json.loads(shipped_path().read_text(encoding="utf-8")))
