"""From looks at one fire to its arrival map: one interface over the methods, and an uncertainty that was calibrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.arrival.extent import Evidence, gather, supported
from services.arrival.field import FieldSettings, fit_field
from services.arrival.grid import FireGrid
from services.arrival.looks import Ignition, Looks
from services.arrival.network import parameter_count
from services.arrival.paper_method import PaperSettings, fit_paper
from services.arrival.svm import SvmSettings, fit_svm
from shared.errors import DomainError

DEFAULT_METHOD = "arrival-field"
METHODS = (DEFAULT_METHOD, "fusion-nn", "svm", "nearest-detection")
# Names that callers used before the methods had theirs.
FORMER_NAMES = {"fusion-nn-paper": "fusion-nn"}
Settings = FieldSettings | PaperSettings | SvmSettings
EDGE_KM = 0.4
MIXING_DISTANCE_KM = 5.0
# Variance of the error (h^2) on synthetic tuning fires: a constant, the spread of the members (too small by itself),
# half a pixel times the pace of the front, the distance to the nearest evidence, and the pass interval as a uniform
# draw (/12).
SD_CONSTANT_H, SPREAD_FACTOR, PACE_KM, DISTANCE_H_PER_KM = 1.1, 1.5, 0.4, 2.8
Z95 = 1.645
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ArrivalMap:
    """Arrival of one fire on its grid, (rows, columns), hours since the reference time; NaN where not burned.

    `flags` names what makes the product weaker than it looks (e.g. `one-detection`).
    """

    grid: FireGrid
    evidence: Evidence
    arrival_h: Floats
    sd_h: Floats
    q05_h: Floats
    q95_h: Floats
    burned_probability: Floats
    flags: tuple[str, ...]
    parameters: int
    model_bytes: int


def nearest_detection(looks: Looks, x_km: Floats, y_km: Floats, radius_km: float = 0.5) -> Floats:
    """The plain baseline: the earliest detection within `radius_km`, else the time of the nearest one; hours (n,)."""
    fire = looks.fire if len(looks.fire) else supported(looks)
    tree = cKDTree(np.column_stack([fire.x_km, fire.y_km]))
    points = np.column_stack([x_km.ravel(), y_km.ravel()])
    _, nearest = tree.query(points)
    arrival = fire.time_h[nearest].copy()
    for index, near in enumerate(tree.query_ball_point(points, radius_km)):
        if near:
            arrival[index] = fire.time_h[near].min()
    return arrival


def _check(looks: Looks, end_h: float, method: str) -> None:
    if method not in METHODS:
        raise DomainError(f"there is no method '{method}'", field="method", value=method, accepted=", ".join(METHODS))
    if len(supported(looks)) == 0:
        raise DomainError(
            "nothing was seen burning or burned: an arrival time has nothing to rest on",
            field="detections",
            value=f"{len(looks)} looks",
            accepted="at least one fire detection or burned-area point",
        )
    if looks.time_h.max() > end_h:
        raise DomainError(
            "a look lies after the end of the period", field="end", value=end_h, accepted="looks up to `end`"
        )


def weak_spots(looks: Looks, ignition: Ignition) -> tuple[str, ...]:
    """What limits this fire's map, as flags for the product."""
    fire = looks.fire
    flags = []
    if len(fire) == 0:
        flags.append("burned-area-only")
    elif len(fire) == 1:
        flags.append("one-detection")
    elif np.ptp(fire.time_h) < 0.2:
        flags.append("one-instant")
    if len(looks.no_fire) == 0:
        flags.append("no-negative-looks")
    if len(fire) and fire.time_h.min() < ignition.time_h - 0.5:
        flags.append("detections-before-reported-start")
    return tuple(flags)


def _pass_interval(looks: Looks, ignition: Ignition, arrival_h: Floats) -> Floats:
    """Hours between the passes (or ignition) that bracket each arrival (n,)."""
    passes = np.unique(np.append(np.round(looks.time_h, 2), ignition.time_h))
    after = np.clip(np.searchsorted(passes, arrival_h), 1, max(passes.size - 1, 1))
    if passes.size == 1:
        return np.full(arrival_h.shape, 24.0)
    return passes[after] - passes[after - 1]


def _pace(arrival_h: Floats, cell_km: float) -> Floats:
    """Hours that the front takes for a kilometre (rows, columns)."""
    if min(arrival_h.shape) < 2:
        return np.zeros_like(arrival_h)
    d_row, d_column = np.gradient(arrival_h, cell_km)
    return np.clip(np.hypot(d_row, d_column), 0.0, 10.0)


@dataclass(frozen=True)
class _Fitted:
    """What a method found: arrival h (members, rows * columns), probability of burned (rows, columns), size."""

    member_h: Floats
    probability: Floats
    parameters: int = 0
    model_bytes: int = 0


def _edge(margin_km: Floats) -> Floats:
    """Probability of burned from the signed distance to the edge of the region."""
    return 1.0 / (1.0 + np.exp(-np.clip(margin_km / EDGE_KM, -30.0, 30.0)))


def _by_field(
    looks: Looks, grid: FireGrid, evidence: Evidence, ignition: Ignition, seed: int, settings: FieldSettings
) -> _Fitted:
    field = fit_field(looks, grid, ignition, settings, seed)
    x, y = grid.cell_centres_km()
    burned = _edge(field.margin_at(x, y)).reshape(grid.shape)
    return _Fitted(field.at(x, y), burned, field.parameters, 4 * field.parameters)


def _by_network(
    looks: Looks, grid: FireGrid, evidence: Evidence, ignition: Ignition, seed: int, settings: PaperSettings
) -> _Fitted:
    """The network decides the extent alone; it is only kept from burning land that nobody saw."""
    fitted = fit_paper(looks, settings, seed)
    x, y = grid.cell_centres_km()
    member_h, member_p = fitted.at(x.ravel(), y.ravel())
    seen = member_p.mean(axis=0).reshape(grid.shape) * (evidence.distance_km <= MIXING_DISTANCE_KM)
    parameters = parameter_count(fitted.network)
    return _Fitted(member_h, seen, parameters, 4 * parameters)


def _by_svm(
    looks: Looks, grid: FireGrid, evidence: Evidence, ignition: Ignition, seed: int, settings: SvmSettings
) -> _Fitted:
    surface = fit_svm(looks, settings, seed)
    x, y = grid.cell_centres_km()
    arrival = surface.at(x, y)
    burned = np.isfinite(arrival).reshape(grid.shape)
    size = surface.support.size + surface.coefficients.size
    return _Fitted(np.nan_to_num(arrival, nan=0.0)[None], burned.astype(float), size, 4 * size)


def _by_nearest(
    looks: Looks, grid: FireGrid, evidence: Evidence, ignition: Ignition, seed: int, settings: None
) -> _Fitted:
    return _Fitted(nearest_detection(looks, *grid.cell_centres_km())[None], _edge(evidence.margin_km))


_FITS: dict[str, tuple[Callable[..., _Fitted], type | None]] = {
    "arrival-field": (_by_field, FieldSettings),
    "fusion-nn": (_by_network, PaperSettings),
    "svm": (_by_svm, SvmSettings),
    "nearest-detection": (_by_nearest, None),
}


def own_settings(method: str) -> Settings | None:
    """The default settings of a method (None: it has none)."""
    kind = _FITS[FORMER_NAMES.get(method, method)][1]
    return kind() if kind else None


def infer_arrival(
    looks: Looks,
    grid: FireGrid,
    ignition: Ignition,
    end_h: float,
    method: str = DEFAULT_METHOD,
    seed: int = 0,
    settings: Settings | None = None,
    progress: Callable[[str], None] | None = None,
) -> ArrivalMap:
    """Arrival map of one fire from its looks up to `end_h`. Raises DomainError without any fire evidence, at an
    unknown method and for looks after `end_h`.

    Settings of another method than the one asked for are not used. Far from evidence of fire nothing burns.
    """
    method = FORMER_NAMES.get(method, method)
    _check(looks, end_h, method)
    if progress:
        progress("fitting")
    evidence = gather(grid, looks)
    fit, kind = _FITS[method]
    chosen = settings if kind and isinstance(settings, kind) else own_settings(method)
    fitted = fit(looks, grid, evidence, ignition, seed, chosen)
    return _finish(looks, grid, evidence, ignition, end_h, fitted)


def _finish(
    looks: Looks,
    grid: FireGrid,
    evidence: Evidence,
    ignition: Ignition,
    end_h: float,
    fitted: _Fitted,
) -> ArrivalMap:
    member_h, probability = fitted.member_h, fitted.probability
    start = ignition.time_h if not len(looks.fire) else min(ignition.time_h, float(looks.fire.time_h.min()))
    arrival = np.median(member_h, axis=0).reshape(grid.shape)
    spread = member_h.std(axis=0, ddof=1).reshape(grid.shape) if member_h.shape[0] > 1 else np.zeros(grid.shape)
    burned = (probability > 0.5) & (arrival <= end_h)
    distance = np.minimum(evidence.distance_km, 1e3)
    flags = weak_spots(looks, ignition)
    variance = (
        SD_CONSTANT_H**2
        + (SPREAD_FACTOR * spread) ** 2
        + _pass_interval(looks, ignition, arrival) ** 2 / 12.0
        + (PACE_KM * _pace(arrival, grid.cell_m / 1e3)) ** 2
        + (DISTANCE_H_PER_KM * distance) ** 2
    )
    if {"one-detection", "one-instant", "burned-area-only"} & set(flags):
        variance = variance + max(end_h - start, 12.0) ** 2 / 12.0
    sd = np.sqrt(variance)
    arrival = np.clip(arrival, start, end_h)
    blank = np.where(burned, 0.0, np.nan)
    late = _late_share(arrival, sd, end_h)
    return ArrivalMap(
        grid,
        evidence,
        arrival + blank,
        sd + blank,
        np.maximum(arrival - Z95 * sd, start) + blank,
        arrival + Z95 * sd + blank,
        np.clip(probability * (1 - late), 0.0, 1.0),
        flags,
        fitted.parameters,
        fitted.model_bytes,
    )


def _late_share(arrival_h: Floats, sd_h: Floats, end_h: float) -> Floats:
    """Roughly the probability that the fire comes only after `end_h`, where arrival is near the end."""
    return np.clip(0.5 + (arrival_h - end_h) / (2 * Z95 * sd_h), 0.0, 0.5)


def quick(settings: Settings | None, epochs: int | None, ensemble: int | None) -> Settings | None:
    """The settings with a caller's budget: training epochs (for the field: of ten steps each) and ensemble members."""
    if isinstance(settings, PaperSettings):
        return replace(settings, epochs=epochs) if epochs else settings
    if isinstance(settings, FieldSettings):
        steps = 10 * epochs if epochs else settings.steps
        return replace(settings, steps=steps, members=ensemble or settings.members)
    return settings
