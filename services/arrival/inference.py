"""From looks at one fire to its arrival map: one interface over the methods, and an uncertainty that was calibrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.arrival.extent import Evidence, gather, supported
from services.arrival.field import Field, FieldSettings, fit_field
from services.arrival.grid import FireGrid
from services.arrival.looks import Ignition, Looks
from services.arrival.network import parameter_count
from services.arrival.paper_method import PaperSettings, fit_paper
from services.arrival.posterior.correction import Corrected, corrected, unlearned
from services.arrival.svm import SvmSettings, fit_svm
from services.arrival.uncertainty import Z95, error_variance, late_share
from shared.errors import DomainError

DEFAULT_METHOD = "arrival-posterior"
FIT_ALONE = "arrival-field"
METHODS = (DEFAULT_METHOD, FIT_ALONE, "fusion-nn", "svm", "nearest-detection")
# Names that callers used before the methods had theirs.
FORMER_NAMES = {"fusion-nn-paper": "fusion-nn"}
Settings = FieldSettings | PaperSettings | SvmSettings
EDGE_KM = 0.4
MIXING_DISTANCE_KM = 5.0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ArrivalMap:
    """Arrival of one fire on its grid, (rows, columns), hours since the reference time; NaN where not burned.

    `flags` names what makes the product weaker than it looks (e.g. `one-detection`). `basis` says what it rests on
    where that is less than its method's name promises.
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
    basis: str = ""


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


@dataclass(frozen=True)
class _Fitted:
    """What a method found: arrival h (members, rows * columns), probability of burned (rows, columns), size; and what
    is known beyond that where it was learned, or why not."""

    member_h: Floats
    probability: Floats
    parameters: int = 0
    model_bytes: int = 0
    learned: Corrected | None = None
    basis: str = ""


def _edge(margin_km: Floats) -> Floats:
    """Probability of burned from the signed distance to the edge of the region."""
    return 1.0 / (1.0 + np.exp(-np.clip(margin_km / EDGE_KM, -30.0, 30.0)))


def _by_field(
    looks: Looks,
    grid: FireGrid,
    evidence: Evidence,
    ignition: Ignition,
    end_h: float,
    seed: int,
    settings: FieldSettings,
) -> _Fitted:
    return _of_field(fit_field(looks, grid, ignition, settings, seed), grid)


def _of_field(field: Field, grid: FireGrid) -> _Fitted:
    x, y = grid.cell_centres_km()
    burned = _edge(field.margin_at(x, y)).reshape(grid.shape)
    return _Fitted(field.at(x, y), burned, field.parameters, 4 * field.parameters)


def _by_posterior(
    looks: Looks,
    grid: FireGrid,
    evidence: Evidence,
    ignition: Ignition,
    end_h: float,
    seed: int,
    settings: FieldSettings,
) -> _Fitted:
    """The field, corrected by what was learned from simulated fires where these looks are such as it knows."""
    field = fit_field(looks, grid, ignition, settings, seed)
    alone, why = _of_field(field, grid), unlearned(looks, ignition, end_h)
    if why:
        return replace(alone, basis=f"{FIT_ALONE}: {why}")
    return replace(alone, learned=corrected(looks, field, grid, ignition, end_h))


def _by_network(
    looks: Looks,
    grid: FireGrid,
    evidence: Evidence,
    ignition: Ignition,
    end_h: float,
    seed: int,
    settings: PaperSettings,
) -> _Fitted:
    """The network decides the extent alone; it is only kept from burning land that nobody saw."""
    fitted = fit_paper(looks, settings, seed)
    x, y = grid.cell_centres_km()
    member_h, member_p = fitted.at(x.ravel(), y.ravel())
    seen = member_p.mean(axis=0).reshape(grid.shape) * (evidence.distance_km <= MIXING_DISTANCE_KM)
    parameters = parameter_count(fitted.network)
    return _Fitted(member_h, seen, parameters, 4 * parameters)


def _by_svm(
    looks: Looks, grid: FireGrid, evidence: Evidence, ignition: Ignition, end_h: float, seed: int, settings: SvmSettings
) -> _Fitted:
    surface = fit_svm(looks, settings, seed)
    x, y = grid.cell_centres_km()
    arrival = surface.at(x, y)
    burned = np.isfinite(arrival).reshape(grid.shape)
    size = surface.support.size + surface.coefficients.size
    return _Fitted(np.nan_to_num(arrival, nan=0.0)[None], burned.astype(float), size, 4 * size)


def _by_nearest(
    looks: Looks, grid: FireGrid, evidence: Evidence, ignition: Ignition, end_h: float, seed: int, settings: None
) -> _Fitted:
    return _Fitted(nearest_detection(looks, *grid.cell_centres_km())[None], _edge(evidence.margin_km))


_FITS: dict[str, tuple[Callable[..., _Fitted], type | None]] = {
    DEFAULT_METHOD: (_by_posterior, FieldSettings),
    FIT_ALONE: (_by_field, FieldSettings),
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
    fitted = fit(looks, grid, evidence, ignition, end_h, seed, chosen)
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
    variance = error_variance(looks, ignition, arrival, spread, distance, grid.cell_m / 1e3)
    if {"one-detection", "one-instant", "burned-area-only"} & set(flags):
        variance = variance + max(end_h - start, 12.0) ** 2 / 12.0
    sd = np.sqrt(variance)
    arrival = np.clip(arrival, start, end_h)
    low, high = np.maximum(arrival - Z95 * sd, start), arrival + Z95 * sd
    probability = np.clip(probability * (1 - late_share(arrival, sd, end_h)), 0.0, 1.0)
    if fitted.learned is not None:
        own, known = fitted.learned, fitted.learned.known
        arrival = np.where(known, np.clip(own.arrival_h, start, end_h), arrival)
        sd = np.where(known, own.sd_h, sd)
        low = np.where(known, np.clip(own.low_h, start, arrival), low)
        high = np.where(known, np.maximum(own.high_h, arrival), high)
        probability = np.where(known, own.burned, probability)
        burned = np.where(known, own.burned > 0.5, burned)
    blank = np.where(burned, 0.0, np.nan)
    return ArrivalMap(
        grid,
        evidence,
        arrival + blank,
        sd + blank,
        low + blank,
        high + blank,
        probability,
        flags,
        fitted.parameters,
        fitted.model_bytes,
        fitted.basis,
    )


def quick(settings: Settings | None, epochs: int | None, ensemble: int | None) -> Settings | None:
    """The settings with a caller's budget: training epochs (for the field: of ten steps each) and ensemble members."""
    if isinstance(settings, PaperSettings):
        return replace(settings, epochs=epochs) if epochs else settings
    if isinstance(settings, FieldSettings):
        steps = 10 * epochs if epochs else settings.steps
        return replace(settings, steps=steps, members=ensemble or settings.members)
    return settings
