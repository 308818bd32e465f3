"""Storage and battery second by second for a command timeline, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.planning.problem import FloatArray, IntArray, PlanningProblem

TOLERANCE_WH = 1e-9


@dataclass(frozen=True)
class Shortfall:
    """The first second at which a satellite breaks ``storage``, ``empty`` or ``battery``."""

    rule: str
    satellite: int
    second: int


def collected_seconds(problem: PlanningProblem, images: IntArray) -> NDArray[np.bool_]:
    """(satellites, seconds): true where an image is taken, frozen ones included."""
    collect = np.zeros_like(problem.sunlit)
    collect[problem.images.satellite[images], problem.images.second[images]] = True
    collect[problem.frozen.satellite, problem.frozen.second] = True
    return collect


def stored_images(problem: PlanningProblem, images: IntArray, downlink: NDArray[np.int16]) -> IntArray:
    """(satellites, seconds): images in storage after each second."""
    collect = collected_seconds(problem, images)
    stored = np.empty(collect.shape, np.int64)
    for s, limits in enumerate(problem.satellites):
        done = np.cumsum(downlink[s] >= 0) // limits.downlink_s_per_image
        stored[s] = limits.stored_images_initial + np.cumsum(collect[s]) - done
    return stored


def battery_wh(problem: PlanningProblem, images: IntArray, downlink: NDArray[np.int16]) -> FloatArray:
    """(satellites, seconds): charge after each second, min(capacity, b + net/3600) unrolled by running maxima."""
    collect = collected_seconds(problem, images)
    battery = np.empty(collect.shape)
    for s, limits in enumerate(problem.satellites):
        net = np.where(problem.sunlit[s], limits.generation_w, 0.0) - limits.nominal_w
        net = net - limits.collect_w * collect[s] - limits.downlink_w * (downlink[s] >= 0)
        free = limits.battery_initial_wh + np.cumsum(net) / 3600.0
        spilled = np.maximum(0.0, np.maximum.accumulate(free - limits.battery_capacity_wh))
        battery[s] = free - spilled
    return battery


def shortfalls(problem: PlanningProblem, images: IntArray, downlink: NDArray[np.int16]) -> list[Shortfall]:
    """The earliest broken resource rule of every satellite that breaks one, in order of time."""
    collect = collected_seconds(problem, images)
    stored = stored_images(problem, images, downlink)
    battery = battery_wh(problem, images, downlink)
    found = []
    for s, limits in enumerate(problem.satellites):
        before = limits.stored_images_initial + np.cumsum(collect[s]) - collect[s]
        empty = np.cumsum(downlink[s] >= 0) > limits.downlink_s_per_image * before
        broken = {
            "storage": collect[s] & (stored[s] > limits.storage_images),
            "empty": empty & (downlink[s] >= 0),
            "battery": battery[s] < limits.battery_min_wh - TOLERANCE_WH,
        }
        own = [Shortfall(rule, s, int(np.argmax(mask))) for rule, mask in broken.items() if mask.any()]
        found += [min(own, key=lambda item: item.second)] if own else []
    return sorted(found, key=lambda item: (item.second, item.satellite))


def first_shortfall(problem: PlanningProblem, images: IntArray, downlink: NDArray[np.int16]) -> Shortfall | None:
    """The earliest broken resource rule of a timeline, or None."""
    return next(iter(shortfalls(problem, images, downlink)), None)
