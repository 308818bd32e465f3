"""What the network reads at every cell: the looks around it by their time since the fitted arrival, and its setting.

Every channel is a scalar that neither turning nor mirroring nor shifting the clock changes, so that what is learned
holds for any direction and hour.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from services.arrival.extent import FINE_KM, Evidence, sightings_per_pixel
from services.arrival.field import Field, first_guess
from services.arrival.footprints import representative
from services.arrival.looks import Ignition, Looks
from services.arrival.posterior.square import Square

# Ages (h) of looks since the fitted arrival: bins from -30 to 42.
YOUNGEST_H, AGE_STEP_H, AGES = -30.0, 3.0, 25
FAR_KM = 5.0
HOURS_OF_DAY, RUN_STEP_H, RUNS = 12, 3.0, 13
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def by_age(square: Square, looks: Looks, sigma_km: Floats, arrival_h: Floats) -> Singles:
    """Gaussian weights of looks at each cell by their age since its arrival; (AGES, rows, columns), log(1 + sum).

    A look between two bins counts in both by its nearness; older and younger ones in the outermost.
    """
    rows, columns = arrival_h.shape
    total = np.zeros(AGES * arrival_h.size)
    if len(looks) == 0:
        return total.reshape(AGES, rows, columns).astype(np.float32)
    row, column = square.index(looks.x_km, looks.y_km)
    sigma = np.maximum(sigma_km / square.cell_km, 0.5)
    reach = np.ceil(2.0 * sigma).astype(int)
    flat = arrival_h.ravel()
    for size in np.unique(reach):
        chosen = np.flatnonzero(reach == size)
        r0, c0 = np.rint(row[chosen]).astype(int), np.rint(column[chosen]).astype(int)
        step = np.arange(-size, size + 1)
        r, c = r0[:, None, None] + step[None, :, None], c0[:, None, None] + step[None, None, :]
        squared = (r - row[chosen, None, None]) ** 2 + (c - column[chosen, None, None]) ** 2
        scaled = squared / sigma[chosen, None, None] ** 2
        near = (scaled <= 4.0) & (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
        which = np.broadcast_to(np.arange(chosen.size)[:, None, None], near.shape)[near]
        cell = np.broadcast_to(r * columns + c, near.shape)[near]
        weight = np.exp(-0.5 * scaled[near])
        age = (looks.time_h[chosen][which] - flat[cell] - YOUNGEST_H) / AGE_STEP_H
        age = np.clip(age, 0.0, AGES - 1.0)
        low = np.minimum(age.astype(int), AGES - 2)
        for offset, share in ((0, 1.0 - (age - low)), (1, age - low)):
            total += np.bincount((low + offset) * flat.size + cell, weight * share, total.size)
    return np.log1p(total).reshape(AGES, rows, columns).astype(np.float32)


def _looks_by_age(square: Square, looks: Looks, arrival_h: Floats) -> tuple[Singles, float]:
    """Fine sightings, coarse sightings and clear looks by age, and the reach (km) of a clear look."""
    fire = looks.fire
    fine = fire.radius_km <= FINE_KM
    parts = [by_age(square, kind, 0.54 * kind.radius_km, arrival_h) for kind in (fire.take(fine), fire.take(~fine))]
    no_fire, reach = looks.no_fire, 1.0
    if len(no_fire):
        no_fire = representative(no_fire)[0]
        reach = float(np.median(no_fire.radius_km))
    parts.append(by_age(square, no_fire, 0.54 * no_fire.radius_km, arrival_h))
    return np.concatenate(parts), reach


def _growth(arrival_h: Floats, inside: NDArray[np.bool_]) -> list[Floats]:
    """How much of the fire arrived at the hours of day around each cell's, and at the hours around its arrival, both
    against the mean over the day or the period; (rows, columns) each."""
    burned = np.sort(arrival_h[inside]) if inside.any() else np.sort(arrival_h.ravel())
    day = np.bincount((burned % 24.0 / 24.0 * 48).astype(int) % 48, minlength=48) / burned.size * 48
    kernel = np.exp(-0.5 * (np.minimum(np.arange(48), 48 - np.arange(48)) / 2.0) ** 2)
    day = np.real(np.fft.ifft(np.fft.fft(day) * np.fft.fft(kernel / kernel.sum())))
    hours, out = np.arange(49) / 2.0 + 0.25, []
    closed = np.append(day, day[0])
    for k in range(HOURS_OF_DAY):
        shifted = (arrival_h + 24.0 / HOURS_OF_DAY * k - 0.25) % 24.0
        out.append(np.log1p(np.maximum(np.interp(shifted, hours - 0.25, closed), 0.0)))
    for k in range(RUNS):
        middle = arrival_h + RUN_STEP_H * (k - RUNS // 2)
        low, high = (np.searchsorted(burned, middle + side) for side in (-0.5 * RUN_STEP_H, 0.5 * RUN_STEP_H))
        out.append(np.log1p(24.0 / RUN_STEP_H * (high - low) / burned.size))
    return out


def _sightings(square: Square, fire: Looks, arrival_h: Floats) -> list[Floats]:
    """How near and dense the sightings are, and when they were; (rows, columns) each."""
    x, y = square.centres()
    cells, place = np.column_stack([x.ravel(), y.ravel()]), np.column_stack([fire.x_km, fire.y_km])
    distance, index = cKDTree(place).query(cells, k=list(range(1, min(len(fire), 16) + 1)))
    time = fire.time_h[index]
    near = distance <= np.maximum(0.7, distance[:, :1] + 0.1)
    fine = fire.radius_km <= FINE_KM
    to_fine = cKDTree(place[fine]).query(cells)[0] if fine.any() else np.full(len(cells), FAR_KM)
    since = arrival_h.ravel()
    columns = [
        np.minimum(distance[:, 0], FAR_KM),
        np.minimum(to_fine, FAR_KM),
        np.minimum(distance[:, -1], FAR_KM),
        *(np.log1p(np.exp(-0.5 * (distance / sigma) ** 2).sum(axis=1)) for sigma in (0.4, 1.2)),
        np.clip((time[:, 0] - since) / 12.0, -3, 3),
        np.clip((np.where(near, time, np.inf).min(axis=1) - since) / 12.0, -3, 3),
        np.clip((np.where(near, time, -np.inf).max(axis=1) - since) / 12.0, -3, 3),
    ]
    return [column.reshape(arrival_h.shape) for column in columns]


def _shape(square: Square, arrival_h: Floats) -> list[Floats]:
    """How the fitted arrival bends, and its pace."""
    pace = np.hypot(*np.gradient(arrival_h, square.cell_km))
    bends = [np.clip((arrival_h - square.blurred(arrival_h, sigma)) / 4.0, -4, 4) for sigma in (0.7, 2.0)]
    return [*bends, np.log1p(pace)]


def channels(
    square: Square, looks: Looks, field: Field, evidence: Evidence, ignition: Ignition, end_h: float
) -> tuple[Singles, Floats]:
    """The channels (n, rows, columns) and the fitted arrival (rows, columns), h. `evidence` lies on the square; all
    in its local km; `looks` with at least one fire."""
    x, y = square.centres()
    arrival = np.median(field.at(x, y), axis=0).reshape(x.shape)
    fire = looks.fire
    start_h = min(ignition.time_h, float(fire.time_h.min()))
    told, reach_km = _looks_by_age(square, looks, arrival)
    inside = (evidence.margin_km > 0) & (arrival <= end_h)
    cells = np.column_stack([x.ravel(), y.ravel()])
    guess = first_guess(fire, ignition, cells, x.shape, 0.7 / square.cell_km, 1.5).reshape(x.shape)
    rasters = [
        *_growth(arrival, inside),
        *_sightings(square, fire, arrival),
        *_shape(square, arrival),
        np.clip((guess - arrival) / 8.0, -4, 4),
        np.clip(evidence.margin_km, -4.0, 4.0),
        np.clip((arrival - start_h) / 24.0, -1, 6),
        np.clip((end_h - arrival) / 24.0, -2, 6),
        np.clip((end_h - arrival) / 6.0, -3, 3),
    ]
    numbers = _of_fire(square, looks, field, inside, reach_km, start_h, end_h)
    constant = [np.full(x.shape, value) for value in numbers]
    return np.concatenate([told, np.stack([*rasters, *constant]).astype(np.float32)]), arrival


def _of_fire(
    square: Square,
    looks: Looks,
    field: Field,
    inside: NDArray[np.bool_],
    reach_km: float,
    start_h: float,
    end_h: float,
) -> list[float]:
    """Numbers of the whole fire: scale, residence, detection, how often it was seen, what it did at the end."""
    fire = looks.fire
    passes = np.unique(np.round(looks.time_h * 10)).size
    return [
        float(np.log(square.cell_km / 0.25)),
        float(np.log(max(np.sqrt(inside.sum()) * square.cell_km, 0.2) / 8.0)),
        float(np.log(field.residence_h / 5.5)),
        2.0 * (field.detection - 0.5),
        sightings_per_pixel(fire),
        float(np.log(len(fire)) / 4.0),
        float((fire.radius_km <= FINE_KM).mean()),
        float(np.log(passes / max(end_h - start_h, 6.0) * 24.0 / 6.0)),
        float(np.log(reach_km)),
        (end_h - start_h) / 72.0 - 1.0,
        min((end_h - float(looks.time_h.max())) / 12.0, 3.0),
        min((end_h - float(fire.time_h.max())) / 12.0, 3.0),
    ]
