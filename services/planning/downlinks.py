"""From collected images to an exact command timeline: which station serves which satellite in every second."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.planning.data_cycles import Chunks, build_chunks
from services.planning.fitting import fitting, held_model, losses
from services.planning.milp import DataCycleModel
from services.planning.problem import BoolArray, FloatArray, IntArray, PlanningProblem
from services.planning.solving import branch_and_bound
from services.planning.timeline import Shortfall, shortfalls

REFINEMENTS = 40
NODES = 200
GUARD_S = 30.0
LATENCY_GAP = 0.005
"""Downlinks this near to the most and earliest possible are good enough: rewards no longer depend on them."""
BATTERY_PIECE_S = 30
BATTERY_MARGIN_WH = 1e-6
"""Kept above the floor where possible, so that solver tolerances never show in the exact replay."""


@dataclass(frozen=True)
class Timeline:
    """Images collected (indices, frozen included) and the station serving each satellite-second (-1: none)."""

    images: IntArray
    downlink: NDArray[np.int16]
    dropped: IntArray
    """Images of the request that no exact timeline could hold."""
    cuts: tuple[tuple[int, int], ...] = ()
    """(satellite, second) at which totals per chunk had to be refined."""
    time_limited: bool = False


@dataclass(frozen=True)
class Settled:
    """Downlinks of a timeline that is exact but for the ``broken`` satellites (a mask)."""

    downlink: NDArray[np.int16]
    broken: BoolArray

    def seconds(self, problem: PlanningProblem, chunks: Chunks, links: IntArray) -> IntArray:
        """New seconds of each of ``links``."""
        new = np.where(problem.frozen.downlink < 0, self.downlink, -1)
        chunk, station = chunks.link_chunk[links], chunks.link_station[links]
        spans = zip(chunks.satellite[chunk], chunks.start_s[chunk], chunks.end_s[chunk], station, strict=True)
        return np.array([np.count_nonzero(new[s, begin:end] == g) for s, begin, end, g in spans], np.int64)


def emit_timeline(
    problem: PlanningProblem, images: IntArray, required: BoolArray, cuts: tuple[tuple[int, int], ...] = ()
) -> Timeline:
    """An exact timeline for ``images`` that brings data down as early as resources allow.

    Totals per chunk come from a small integer program. Where second-by-second simulation finds a rule broken inside a
    chunk, the chunk is cut there and the program solved again; of images that still do not fit the most valuable part
    is kept, with the ``required`` targets if it can be. ``cuts`` (satellite, second) are made from the start.
    """
    wanted = np.unique(np.concatenate([images, problem.frozen_images])).astype(np.int64)
    pool, kept, cut = wanted, wanted, False
    settled: Settled | None = None
    for _ in range(2 * REFINEMENTS * max(1, len(problem.satellites)) + 2 * len(wanted)):
        chunks = build_chunks(problem, cuts)
        seconds, slow = _downlink_seconds(problem, chunks, kept, settled)
        cut |= slow
        if seconds is None and settled is not None:
            settled = None
            continue
        if seconds is None:
            # From all that may be had, not only from what went into coarser chunks.
            part, slow = fitting(problem, chunks, pool, required)
            cut |= slow
            if part is None or np.array_equal(part, kept):
                part = _without_cheapest(problem, kept, Shortfall("storage", 0, problem.horizon_s))
                pool = np.setdiff1d(pool, np.setdiff1d(kept, part))
            kept = part
            continue
        downlink = place_seconds(problem, chunks, kept, seconds)
        broken = shortfalls(problem, kept, downlink)
        if not broken:
            return Timeline(kept, downlink, np.setdiff1d(wanted, kept), cuts, cut)
        part, cuts = _mended(problem, chunks, kept, broken, cuts)
        pool, kept = np.setdiff1d(pool, np.setdiff1d(kept, part)), part
        settled = Settled(downlink, np.isin(np.arange(len(problem.satellites)), [x.satellite for x in broken]))
    raise RuntimeError("no exact timeline exists even without new images")


def _mended(
    problem: PlanningProblem, chunks: Chunks, kept: IntArray, broken: list[Shortfall], cuts: tuple[tuple[int, int], ...]
) -> tuple[IntArray, tuple[tuple[int, int], ...]]:
    """Images and cuts for the next attempt: finer chunks at every break, an image less where cuts no longer help."""
    for item in broken:
        finer = _finer(problem, chunks, kept, item, cuts)
        if finer == cuts or sum(s == item.satellite for s, _ in finer) > 4 * REFINEMENTS:
            kept = _without_cheapest(problem, kept, item)
        cuts = finer
    return kept, cuts


def _finer(
    problem: PlanningProblem, chunks: Chunks, images: IntArray, broken: Shortfall, cuts: tuple[tuple[int, int], ...]
) -> tuple[tuple[int, int], ...]:
    """Cuts at the break; where those exist already, around its satellite's last images taken during contacts before it.

    Downlinks and images in one chunk are the one thing whose order totals do not tell.
    """
    s = broken.satellite
    new = {*cuts, (s, broken.second), (s, broken.second + 1)}
    if broken.rule == "battery":  # draining and charging alternate within a chunk: keep them apart
        first = chunks.offset[s] + np.searchsorted(
            chunks.end_s[chunks.offset[s] : chunks.offset[s + 1]], broken.second, "right"
        )
        pieces = range(int(chunks.start_s[first]), int(chunks.end_s[first]), BATTERY_PIECE_S)
        new |= {(s, second) for second in pieces}
    if len(new) == len(cuts):
        chunk = chunks.image_chunk[images]
        long = chunks.end_s[chunk] - chunks.start_s[chunk] > 1
        near = np.isin(chunk, chunks.link_chunk) & long & (chunks.satellite[chunk] == s)
        near &= chunks.start_s[chunk] <= broken.second
        for second in np.sort(problem.images.second[images[near]])[-2:].tolist():
            new |= {(s, second), (s, second + 1)}
    return tuple(sorted(new))


def _fixed_model(
    problem: PlanningProblem, chunks: Chunks, images: IntArray, margin_wh: float, settled: Settled | None
) -> tuple[DataCycleModel, BoolArray]:
    """The model of ``images`` all taken, its early downlinks worth more than late ones, and which columns are whole."""
    model = held_model(problem, chunks, images)
    low, high, cost, whole = model.low.copy(), model.high.copy(), model.cost.copy(), np.zeros(len(model.cost), bool)
    low[: model.images] = 1.0
    links = slice(model.images + model.groups, model.images + model.groups + model.links)
    # early seconds are worth up to twice as much as late ones: throughput first, then latency
    cost[links] = 2.0 - chunks.start_s[chunks.link_chunk] / problem.horizon_s
    whole[links] = True
    free = np.ones(len(problem.satellites), bool) if settled is None else settled.broken
    low[len(low) - len(chunks) :] += margin_wh * free[chunks.satellite]
    if settled is not None:
        held = np.flatnonzero(~free[chunks.satellite[chunks.link_chunk]])
        low[held + links.start] = high[held + links.start] = settled.seconds(problem, chunks, held)
        whole[held + links.start] = False
    return replace(model, low=low, high=high, cost=cost), whole


def _downlink_seconds(
    problem: PlanningProblem, chunks: Chunks, images: IntArray, settled: Settled | None
) -> tuple[IntArray | None, bool]:
    """Whole seconds per link, as much and as early as possible (None: images do not fit), and whether time cut it.

    Satellites that ``settled`` does not call broken keep the seconds they have.
    """
    cut = False
    for margin_wh in (BATTERY_MARGIN_WH, 0.0):
        model, whole = _fixed_model(problem, chunks, images, margin_wh, settled)
        solution = branch_and_bound(model, whole, LATENCY_GAP, NODES, GUARD_S)
        cut |= solution.time_limited
        if solution.feasible:
            return np.rint(solution.links).astype(np.int64), cut
    return None, cut


def _without_cheapest(problem: PlanningProblem, images: IntArray, broken: Shortfall) -> IntArray:
    """``images`` less the one of the broken satellite, before the break, whose loss costs least."""
    own = problem.images
    movable = images[~np.isin(images, problem.frozen_images)]
    near = movable[(own.satellite[movable] == broken.satellite) & (own.second[movable] <= broken.second)]
    pool = near if len(near) else movable
    if not len(pool):
        raise RuntimeError(f"rule {broken.rule} is broken at second {broken.second} without any new image")
    return np.setdiff1d(images, pool[int(np.argmin(losses(problem, images, pool)))])


def place_seconds(problem: PlanningProblem, chunks: Chunks, images: IntArray, seconds: IntArray) -> NDArray[np.int16]:
    """Give each link its seconds: contiguous blocks where nothing interferes, else second by second."""
    downlink = problem.frozen.downlink.copy()
    busy = np.zeros_like(problem.sunlit)
    busy[problem.images.satellite[images], problem.images.second[images]] = True
    busy[problem.frozen.satellite, problem.frozen.second] = True
    fullness = _fullness(problem, chunks, images, seconds)
    spans: dict[tuple[int, int], list[int]] = {}
    for link in np.flatnonzero(seconds > 0):
        chunk = chunks.link_chunk[link]
        spans.setdefault((int(chunks.start_s[chunk]), int(chunks.end_s[chunk])), []).append(int(link))
    for (begin, end), links in sorted(spans.items()):
        satellites = [int(chunks.satellite[chunks.link_chunk[link]]) for link in links]
        if len(set(satellites)) == len(satellites) and not busy[satellites, begin:end].any():
            _blocks(chunks, links, seconds, fullness, downlink)
        else:
            _second_by_second(problem, chunks, links, seconds, begin, end, downlink, busy)
    return downlink


def _fullness(problem: PlanningProblem, chunks: Chunks, images: IntArray, seconds: IntArray) -> FloatArray:
    """Charge at the start of each chunk from totals, as a fraction of the span between floor and capacity."""
    collect = np.bincount(chunks.image_chunk[images], minlength=len(chunks))
    known = np.bincount(chunks.image_chunk[problem.frozen_images], minlength=len(chunks))
    collect = collect + chunks.frozen_collect - known
    downlink = np.bincount(chunks.link_chunk, seconds, minlength=len(chunks)) + chunks.frozen_downlink
    fullness = np.zeros(len(chunks))
    for s, limits in enumerate(problem.satellites):
        charge, span = limits.battery_initial_wh, max(1e-9, limits.battery_capacity_wh - limits.battery_min_wh)
        for c in range(chunks.offset[s], chunks.offset[s + 1]):
            fullness[c] = (charge - limits.battery_min_wh) / span
            energy = chunks.base_w[c] * (chunks.end_s[c] - chunks.start_s[c])
            energy -= limits.collect_w * collect[c] + limits.downlink_w * downlink[c]
            charge = min(limits.battery_capacity_wh, charge + energy / 3600)
    return fullness


def _blocks(
    chunks: Chunks, links: list[int], seconds: IntArray, fullness: FloatArray, downlink: NDArray[np.int16]
) -> None:
    """Full batteries downlink first, so that charging is not lost; low ones last, after charging."""
    head: dict[int, int] = {}
    tail: dict[int, int] = {}
    for link in sorted(links, key=lambda item: (fullness[chunks.link_chunk[item]], item)):
        chunk, station, length = chunks.link_chunk[link], int(chunks.link_station[link]), int(seconds[link])
        if fullness[chunk] < 0.5:
            stop = tail.get(station, int(chunks.end_s[chunk]))
            begin = tail[station] = stop - length
        else:
            begin = head.get(station, int(chunks.start_s[chunk]))
            stop = head[station] = begin + length
        downlink[chunks.satellite[chunk], begin:stop] = station


def _second_by_second(
    problem: PlanningProblem, chunks: Chunks, links: list[int], seconds: IntArray, begin: int, end: int,
    downlink: NDArray[np.int16], busy: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Largest remaining need first, skipping seconds of collecting and of empty storage."""
    need = {link: int(seconds[link]) for link in links}
    satellite = {link: int(chunks.satellite[chunks.link_chunk[link]]) for link in links}
    room = {}
    for s in set(satellite.values()):
        limits = problem.satellites[s]
        taken = int(busy[s, :begin].sum()) + limits.stored_images_initial
        room[s] = taken * limits.downlink_s_per_image - int((downlink[s, :begin] >= 0).sum())
    for t in range(begin, end):
        stations, served = set(), set()
        for link in sorted(links, key=lambda item: (-need[item], item)):
            s, station = satellite[link], int(chunks.link_station[link])
            if need[link] and station not in stations and s not in served and not busy[s, t] and room[s] > 0:
                downlink[s, t] = station
                need[link] -= 1
                room[s] -= 1
                stations.add(station)
                served.add(s)
        for s in room:
            room[s] += problem.satellites[s].downlink_s_per_image * int(busy[s, t])
