"""The published peer: a support vector machine that parts burned from unburned points in space and time.

After the description of Farguell et al. 2021 (Remote Sensing 13, 2203), written afresh: longitude, latitude and time
scaled to [0, 1]; detections +1, looks without fire -1; artificial points above each detection (once burned, burned)
and a sheet of unburned points below all data; radial basis kernel with balanced classes; the arrival time of a place
is the first root of the decision function along time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from services.arrival.extent import is_fire_evidence
from services.arrival.looks import Looks
from shared.errors import DomainError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SvmSettings:
    """`gamma_factor` multiplies the published kernel coefficient, `penalty` the published C; both, and the radius
    `clean_km` around a detection within which later looks without fire are dropped (that ground may have burned out),
    are the best on tuning seeds of the synthetic fires.

    `upper_step` and `lower_step` (of the scaled time) space the artificial points above detections and below looks
    without fire; None leaves them out. `sheet` unburned points a side lie `sheet_gap` below the earliest look.
    """

    gamma_factor: float = 160.0
    penalty: float = 1.0
    clean_km: float = 0.7
    upper_step: float | None = 0.1
    lower_step: float | None = None
    sheet: int = 20
    sheet_gap: float = 0.1
    fire_margin: float = 0.3
    most_points: int = 4000


@dataclass(frozen=True)
class SvmSurface:
    """A fitted machine: support vectors (n, 3) scaled, their coefficients, kernel gamma, and the scaling."""

    support: Floats
    coefficients: Floats
    intercept: float
    gamma: float
    low: Floats
    span: Floats
    levels: int

    def decision(self, place: Floats, time: Floats) -> Floats:
        """Decision function of scaled places (n, 2) at scaled times (m,); (n, m). The kernel factorises."""
        out = np.full((len(place), len(time)), self.intercept)
        along = np.exp(-self.gamma * (self.support[:, 2:] - time[None]) ** 2)
        for rows in np.array_split(np.arange(len(place)), max(len(place) // 4096, 1)):
            square = ((place[rows, None] - self.support[None, :, :2]) ** 2).sum(axis=2)
            out[rows] += (np.exp(-self.gamma * square) * self.coefficients) @ along
        return out

    def at(self, x_km: Floats, y_km: Floats) -> Floats:
        """Arrival, hours, at points (n,): the first root along time; NaN where the machine sees no fire."""
        place = (np.column_stack([np.ravel(x_km), np.ravel(y_km)]) - self.low[:2]) / self.span[:2]
        time = np.linspace(0.0, 1.0, self.levels)
        arrival = np.full(len(place), np.nan)
        near = (np.abs(place - 0.5) <= 1.0).all(axis=1)  # the published grid spans the data, not the plane
        arrival[near] = first_root(time, self.decision(place[near], time)) * self.span[2] + self.low[2]
        return arrival


def first_root(time: Floats, values: Floats, finer: int = 8) -> Floats:
    """First time (n,) at which cubic splines through values (n, m) at times (m,) turn positive; the first time where
    they start positive; NaN where they never do."""
    if values.shape[0] == 0:
        return np.zeros(0)
    fine = np.linspace(time[0], time[-1], finer * (time.size - 1) + 1)
    curve = CubicSpline(time, values, axis=1)(fine)
    positive = curve > 0
    after = positive.argmax(axis=1)
    rows, before = np.arange(len(values)), np.maximum(after - 1, 0)
    low, high = curve[rows, before], curve[rows, after]
    part = np.where(after > 0, -low / np.where(high > low, high - low, 1.0), 0.0)
    root = fine[before] + part * (fine[after] - fine[before])
    return np.where(positive.any(axis=1), root, np.nan)


def _cleaned(fire: Floats, other: Floats, reach: Floats) -> Floats:
    """Looks without fire less those after a detection at the same place: that ground may have burned out."""
    kept = np.ones(len(other), bool)
    tree = cKDTree(fire[:, :2])
    for index, near in enumerate(tree.query_ball_point(other[:, :2], reach)):
        if near and fire[near, 2].min() <= other[index, 2]:
            kept[index] = False
    return other[kept]


def _artificial(fire: Floats, other: Floats, settings: SvmSettings) -> tuple[Floats, Floats]:
    """Fire points above each scaled detection, unburned points below each look and a sheet below everything."""
    burned, unburned = [fire], [other]
    if settings.upper_step:
        for step in np.arange(settings.upper_step, 1.0 + 1e-9, settings.upper_step):
            above = fire + np.array([0.0, 0.0, step])
            burned.append(above[above[:, 2] <= 1.0])
    if settings.lower_step:
        for step in np.arange(settings.lower_step, 1.0 + 1e-9, settings.lower_step):
            below = other - np.array([0.0, 0.0, step])
            unburned.append(below[below[:, 2] >= 0.0])
    if settings.sheet:
        side = np.linspace(0.0, 1.0, settings.sheet)
        x, y = np.meshgrid(side, side)
        unburned.append(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -settings.sheet_gap)]))
    return np.concatenate(burned), np.concatenate(unburned)


def _thinned(points: Floats, most: int, generator: np.random.Generator) -> Floats:
    if len(points) <= most:
        return points
    return points[np.sort(generator.choice(len(points), most, replace=False))]


def _training_points(looks: Looks, settings: SvmSettings, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Scaled burned and unburned points, artificial ones included, with the low corner and span of the scaling."""
    generator = np.random.default_rng(seed)
    burned = is_fire_evidence(looks)
    points = np.column_stack([looks.x_km, looks.y_km, looks.time_h])
    low, high = points[burned].min(axis=0), points[burned].max(axis=0)
    pad = np.maximum(settings.fire_margin * (high - low), [1.0, 1.0, 0.0])
    near = ((points[:, :2] >= (low - pad)[:2]) & (points[:, :2] <= (high + pad)[:2])).all(axis=1) & ~burned
    fire, other = points[burned], points[near]
    if settings.clean_km > 0 and len(other):
        other = _cleaned(fire, other, np.maximum(looks.radius_km[near], settings.clean_km))
    together = np.concatenate([fire, other])
    low, span = together.min(axis=0), np.maximum(np.ptp(together, axis=0), [0.5, 0.5, 1.0])
    half = settings.most_points // 2
    fire, other = ((_thinned(part, half, generator) - low) / span for part in (fire, other))
    fire, other = (_thinned(part, half, generator) for part in _artificial(fire, other, settings))
    return fire, other, low, span


def fit_svm(looks: Looks, settings: SvmSettings, seed: int) -> SvmSurface:
    """Train on looks with fire and without. Deterministic in its inputs and `seed`, which thins large classes.

    Raises DomainError where nothing is unburned (no such look and no artificial sheet): one class cannot be parted.
    """
    from sklearn.svm import SVC

    fire, other, low, span = _training_points(looks, settings, seed)
    if len(other) == 0:
        message = "a support vector machine needs looks that saw no fire, or artificial ones"
        raise DomainError(message, field="detections", value="no such look", accepted="looks with fire = false")
    x = np.concatenate([fire, other])
    y = np.concatenate([np.ones(len(fire)), -np.ones(len(other))])
    scale = np.sqrt(len(x)) / 12.0
    gamma = settings.gamma_factor * scale / (3.0 * x.std())
    machine = SVC(C=settings.penalty * scale, gamma=gamma, class_weight="balanced", cache_size=400, max_iter=300_000)
    machine.fit(x, y)
    levels = max(int(np.ceil(len(x) ** (1 / 3))), 4)
    return SvmSurface(
        machine.support_vectors_, machine.dual_coef_[0], float(machine.intercept_[0]), gamma, low, span, levels
    )
