"""Planning cases for the tests: small ones made here from a seed, and an exhaustive optimum for tiny ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import geopandas
import numpy as np
import pandas as pd
from shapely.geometry import Point

from shared.contracts.spacecraft import Spacecraft

START = pd.Timestamp("2025-01-08T00:00:00Z")
CRAFT: dict[str, Any] = {
    "storage_images": 2, "downlink_s_per_image": 2, "battery_capacity_wh": 10.0, "battery_min_wh": 2.0,
    "battery_initial_wh": 8.0, "generation_w": 3600.0, "nominal_w": 1800.0, "collect_w": 1800.0, "downlink_w": 2700.0,
    "horizon_start": START.isoformat(), "horizon_s": 14,
}  # fmt: skip


def at(second: float) -> pd.Timestamp:
    return START + pd.Timedelta(seconds=second)


@dataclass(frozen=True)
class Case:
    """Tables of one case; times below are seconds from the start."""

    images: list[tuple[int, str, float, list[int]]]
    rewards: dict[int, tuple[str, float]]
    contacts: list[tuple[str, str, float, float]]
    eclipses: list[tuple[str, float, float]] = field(default_factory=list)
    craft: dict[str, Any] = field(default_factory=dict)
    pointing: dict[int, str] = field(default_factory=dict)
    """Pointing of each image; empty: agility is off."""

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        rows = [(i, s, at(t), target) for i, s, t, covered in self.images for target in covered]
        opportunities = pd.DataFrame(rows, columns=["image_id", "satellite", "time", "target_id"])
        if self.pointing:
            opportunities["pointing"] = [self.pointing[i] for i in opportunities["image_id"]]
        targets = geopandas.GeoDataFrame(
            {
                "target_id": list(self.rewards), "kind": [k for k, _ in self.rewards.values()],
                "priority": [r for _, r in self.rewards.values()],
            },
            geometry=[Point(-118.0 + 0.1 * i, 34.0) for i in range(len(self.rewards))], crs="EPSG:4326",
        )  # fmt: skip
        contacts = pd.DataFrame(
            [(s, g, at(a), at(b)) for s, g, a, b in self.contacts], columns=["satellite", "station", "start", "end"]
        )
        eclipses = pd.DataFrame([(s, at(a), at(b)) for s, a, b in self.eclipses], columns=["satellite", "start", "end"])
        for frame in (opportunities, contacts, eclipses):
            for name in {"time", "start", "end"} & set(frame.columns):
                frame[name] = pd.to_datetime(frame[name], utc=True)
        return {"opportunities": opportunities, "targets": targets, "contacts": contacts, "eclipses": eclipses}

    @property
    def spacecraft(self) -> Spacecraft:
        return Spacecraft.model_validate({**CRAFT, **self.craft})


def random_case(seed: int, satellites: int = 2, images: int = 7, tight: bool = True) -> Case:
    """A tiny case in which storage, battery and stations often bind."""
    rng = np.random.default_rng(seed)
    names = [f"CYGFM0{i + 1}" for i in range(satellites)]
    horizon = 14
    places = rng.permutation(satellites * horizon)[:images]
    shots = [
        (
            int(i),
            names[p // horizon],
            float(p % horizon),
            sorted(rng.choice(5, rng.integers(1, 4), replace=False).tolist()),
        )
        for i, p in enumerate(places)
    ]
    rewards = {
        t: ("active" if rng.random() < 0.3 else "prefire", round(float(rng.uniform(0.1, 3)), 2)) for t in range(5)
    }
    contacts = []
    for name in names:
        for station in ("hawaii", "dongara"):
            begin = float(rng.uniform(0, horizon - 3))
            contacts.append((name, station, begin, begin + float(rng.uniform(1, 6))))
    dark = [(name, begin := float(rng.uniform(0, 10)), begin + float(rng.uniform(0, 4))) for name in names]
    craft = {"battery_initial_wh": float(rng.choice([5.5, 6.5, 8.0])), "storage_images": int(rng.integers(1, 3))}
    return Case(shots, rewards, contacts, dark, craft if tight else {"storage_images": 4, "battery_initial_wh": 10.0})


def exhaustive_optimum(
    case: Case, mandatory: bool = False, worth: Callable[[Case, int, bool], float] | None = None
) -> float:
    """Best objective over every possible command of every satellite in every second (breadth-first over states).

    ``worth`` of a set of images (a bit mask); equation 1 if None.
    """
    craft = case.spacecraft
    names = sorted({s for _, s, _, _ in case.images} | {c[0] for c in case.contacts})
    shot = {(s, int(t)): number for number, (_, s, t, _) in enumerate(case.images)}
    states = {(0, tuple((0, 0, craft.battery_initial_wh) for _ in names))}
    for second in range(craft.horizon_s):
        reached = set()
        for mask, fleet in states:
            partial = [(mask, (), frozenset())]
            for name, state in zip(names, fleet, strict=True):
                partial = [
                    (m | extra, (*done, after), used | taken)
                    for m, done, used in partial
                    for extra, after, taken in _choices(case, craft, name, state, second, shot)
                    if not (used & taken)
                ]
            reached.update((m, done) for m, done, _ in partial)
        states = reached
    totals = [(worth or _value)(case, mask, mandatory) for mask in {mask for mask, _ in states}]
    return max(totals)


def _choices(case: Case, craft: Spacecraft, name: str, state: tuple, second: int, shot: dict) -> list[tuple]:
    stored, progress, battery = state
    dark = any(s == name and a < second + 1 and b > second for s, a, b in case.eclipses)
    base = (0.0 if dark else craft.generation_w) - craft.nominal_w
    options = [(0, stored, progress, 0.0, frozenset())]
    if (name, second) in shot and stored < craft.storage_images:
        options.append((1 << shot[(name, second)], stored + 1, progress, craft.collect_w, frozenset()))
    for s, station, a, b in case.contacts:
        if s == name and a <= second and second + 1 <= b and stored > 0:
            done = progress + 1 == craft.downlink_s_per_image
            options.append((0, stored - done, 0 if done else progress + 1, craft.downlink_w, frozenset([station])))
    result = []
    for mask, left, part, extra, used in options:
        charge = min(craft.battery_capacity_wh, battery + (base - extra) / 3600.0)
        if charge >= craft.battery_min_wh - 1e-9:
            result.append((mask, (left, part, round(charge, 9)), used))
    return result


def _value(case: Case, mask: int, mandatory: bool) -> float:
    seen = {t for number, (_, _, _, covered) in enumerate(case.images) if mask >> number & 1 for t in covered}
    reachable = {t for _, _, _, covered in case.images for t in covered}
    if mandatory and any(k == "active" and t in reachable and t not in seen for t, (k, _) in case.rewards.items()):
        return -np.inf
    return sum((10 if k == "active" else 1) * r for t, (k, r) in case.rewards.items() if t in seen)
