"""The fitted field corrected: a distribution of the arrival at every cell, and the probability of burned by the end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from services.arrival.extent import gather, supported
from services.arrival.field import Field
from services.arrival.grid import FireGrid
from services.arrival.looks import BURNED_AREA, FIRE, Ignition, Looks
from services.arrival.posterior.channels import channels
from services.arrival.posterior.network import EARLIEST_H, OFFSET_STEP_H, predict
from services.arrival.posterior.square import square_around

# The network is used only for looks such as the fires have from which it learned (1 to 6 days, up to 8 passes a day).
FEWEST, COARSEST_KM = 8, 1.2
SHORTEST_H, LONGEST_H, MOST_PASSES_A_DAY = 18.0, 156.0, 12.0
SURELY_NOT = -9.0
# The network is a little too unsure of itself: to this power, its probabilities hold 90 % on tuning fires.
SHARPNESS = 1.15
SHARES, Z95 = (0.5, 0.05, 0.95), 1.645
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Corrected:
    """Per cell (rows, columns): median arrival (h), standard deviation of a normal distribution with its 5 and 95 %
    interval, that interval, probability of burned by the end, and whether the correction speaks about it."""

    arrival_h: Floats
    sd_h: Floats
    low_h: Floats
    high_h: Floats
    burned: Floats
    known: NDArray[np.bool_]


def unlearned(looks: Looks, ignition: Ignition, end_h: float) -> str:
    """Why the correction does not hold for these looks; empty where it does."""
    fire = looks.fire
    if len(fire) < FEWEST:
        return f"fewer than {FEWEST} sightings"
    period_h = end_h - min(ignition.time_h, float(fire.time_h.min()))
    passes = np.unique(np.round(_active(looks).time_h * 10)).size
    reasons = {
        "sightings coarser than polar orbiters'": float(np.median(fire.radius_km)) > COARSEST_KM,
        "sightings at one instant": float(np.ptp(fire.time_h)) < 0.2,
        "no look without fire": len(looks.no_fire) == 0,
        "a period shorter than 18 hours": period_h < SHORTEST_H,
        "a period longer than 6.5 days": period_h > LONGEST_H,
        "more than 12 passes a day": passes > MOST_PASSES_A_DAY * max(period_h, 24.0) / 24.0,
    }
    return next((why for why, holds in reasons.items() if holds), "")


def _active(looks: Looks) -> Looks:
    """The looks that the network knows of: with and without fire, no burned-area points."""
    return looks.take(looks.kind != BURNED_AREA)


def quantiles(probability: Floats, shares: tuple[float, ...]) -> Floats:
    """Offsets (shares, ...) h at which the distribution (offsets, ...), even within each step, reaches each share."""
    reached = np.cumsum(probability, axis=0)
    reached = np.concatenate([np.zeros_like(reached[:1]), reached / reached[-1:]])
    out = []
    for share in shares:
        step = np.clip((reached < share).sum(axis=0) - 1, 0, len(probability) - 1)[None]
        low, high = (np.take_along_axis(reached, step + k, axis=0)[0] for k in (0, 1))
        part = (share - low) / np.maximum(high - low, 1e-12)
        out.append(EARLIEST_H + OFFSET_STEP_H * (step[0] + part - 0.5))
    return np.stack(out)


def corrected(looks: Looks, field: Field, grid: FireGrid, ignition: Ignition, end_h: float) -> Corrected:
    """The arrival on a grid, from the looks and the field fitted to them; `looks` with at least one fire. Beyond the
    square around the sightings nothing burned."""
    square = square_around(looks.fire)
    own = FireGrid(grid.epsg, 1e3 * square.x_km, 1e3 * square.y_km, 1e3 * square.cell_km)
    active = _active(looks)
    evidence = gather(own, active.moved(*(-value for value in own.origin_km)))
    read, _ = channels(square, active, field, evidence, ignition, end_h)
    probability, odds = predict(read, evidence.margin_km)
    offsets = quantiles(probability**SHARPNESS, SHARES)
    x, y = (values.ravel() for values in grid.cell_centres_km())
    index = square.index(x, y)
    median, low, high = (
        map_coordinates(values, index, order=1, mode="nearest").reshape(grid.shape) for values in offsets
    )
    logit = map_coordinates(odds, index, order=1, mode="constant", cval=SURELY_NOT).reshape(grid.shape)
    fitted = np.median(field.at(x, y), axis=0).reshape(grid.shape)
    return Corrected(
        fitted + median,
        np.maximum((high - low) / (2 * Z95), 0.1),
        fitted + low,
        fitted + high,
        np.asarray(1.0 / (1.0 + np.exp(-logit))),
        _nearer_to_fire(looks, x, y).reshape(grid.shape),
    )


def _nearer_to_fire(looks: Looks, x_km: Floats, y_km: Floats) -> NDArray[np.bool_]:
    """Points (n,) nearer to a detection than to a certain burned-area point, of which the network knows nothing."""
    anchor = supported(looks)
    if (anchor.kind == FIRE).all():
        return np.ones(x_km.size, bool)
    nearest = cKDTree(np.column_stack([anchor.x_km, anchor.y_km])).query(np.column_stack([x_km, y_km]))[1]
    return np.asarray(anchor.kind[nearest] == FIRE)
