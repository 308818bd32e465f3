"""Soil moisture on simulated worlds (9 km, both modes) and on real looks over Texas (36 km), always held out."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from services.retrieval.ease_grid import row_column
from services.retrieval.looks.features import read_observations
from services.retrieval.simulation.observations import simulate_nominal, simulate_raw_if
from services.retrieval.simulation.surface import Surface
from services.retrieval.simulation.training_world import (
    DAY_MS,
    WorldPlan,
    make_images,
    make_specular_points,
    make_surface,
)
from services.retrieval.soil_moisture import raw_if_training, skill
from services.retrieval.soil_moisture.regression import match
from tests.services.retrieval.texas import texas_pairs

WORLDS = [WorldPlan(7300 + n, 30.0 + 6 * n, -104.0 - 5 * n, days_before=30, days_after=0, fires=0) for n in range(3)]
SMAP_NOISE = 0.03
RAW_IF_SHARE = 0.06


def smap_like(surface: Surface, seed: int) -> pd.DataFrame:
    """The surface's soil moisture as a radiometer gives it on 9 km cells: every other day, 0.03 m3/m3 of noise."""
    latitude, longitude = np.meshgrid(surface.latitude_deg, surface.longitude_deg, indexing="ij")
    row, column = row_column(latitude.ravel(), longitude.ravel(), 9)
    rng = np.random.default_rng([seed, 9])
    parts = []
    for index in range(0, len(surface.time), 2):
        field = pd.DataFrame({"row": row, "column": column, "soil_moisture": surface.soil_moisture[index].ravel()})
        field = field.groupby(["row", "column"], as_index=False)["soil_moisture"].mean()
        noisy = field["soil_moisture"] + rng.normal(0.0, SMAP_NOISE, len(field))
        parts.append(field.assign(soil_moisture=noisy.clip(0.02, 0.6), time=surface.time[index]))
    return pd.concat(parts, ignore_index=True)


def world_looks(plan: WorldPlan, surface: Surface) -> pd.DataFrame:
    """Looks of both modes over the world's days."""
    points = make_specular_points(plan, plan.first_ms, plan.first_ms + plan.days_before * DAY_MS, 0)
    images = make_images(points, RAW_IF_SHARE, plan.seed)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "nominal.nc", Path(folder) / "raw_if.nc"]
        simulate_nominal(points, surface, plan.seed).write(paths[0], {})
        simulate_raw_if(points, images, surface, plan.seed).write(paths[1], {})
        return read_observations(paths).looks


def simulated(method: str = "cqr") -> list[dict[str, Any]]:
    """Per world: ``raw_if`` at held-out places and dates; of the first also ``nominal`` ways of holding out at 9 km.

    A world holds some 200 raw-IF cell-days to judge by, whose coverage alone is good to 3 % at best.
    """
    return [_world(plan, method, number == 0) for number, plan in enumerate(WORLDS)]


def _world(plan: WorldPlan, method: str, nominal: bool) -> dict[str, Any]:
    surface = make_surface(plan)
    looks, truth = world_looks(plan, surface), smap_like(surface, plan.seed)
    reference = skill.train_reference(looks, truth)
    pairs = match(looks, truth, float(reference["incidence_slope_db_per_deg"].iloc[0]))
    _, raw_if = raw_if_training.train(looks, reference, truth, method)
    return {**({"nominal": skill.evaluate(pairs)} if nominal else {}), "raw_if": raw_if}


def mean_coverage(reports: list[dict[str, Any]], *path: str) -> float:
    """Coverage over worlds, weighted by their cell-days; ``path`` leads to a skill in a report, where it has it."""
    found = []
    for report in reports:
        if path[0] not in report:
            continue
        for name in path:
            report = report[name]
        found.append((report["count"], report["interval90_coverage"]))
    return float(np.average([coverage for _, coverage in found], weights=[count for count, _ in found]))


def texas_figures(folder: Path) -> Iterator[tuple[str, float, str, float | None]]:
    """Name, value, unit and bar of the figures on real looks."""
    report = skill.evaluate(texas_pairs(folder), 36)
    named = {
        "": report["leave_a_day_out"],
        "_block_out": report["leave_a_block_out"],
        "_march_to_september": report["transfer"]["first_to_second"],
        "_september_to_march": report["transfer"]["second_to_first"],
    }
    for suffix, found in named.items():
        for model, tail in (("regression", ""), ("cell_mean_baseline", "_baseline")):
            yield f"sm_ubrmse_texas{suffix}{tail}", found[model]["ubrmse"], "m3/m3", None
            yield f"sm_bias_texas{suffix}{tail}", found[model]["bias"], "m3/m3", None
            yield f"sm_r_texas{suffix}{tail}", found[model]["r"], "1", None
        yield f"sm_interval90_coverage_texas{suffix}", found["regression"]["interval90_coverage"], "1", 0.9
