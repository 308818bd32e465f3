"""Raw-IF soil moisture from end to end: simulated, trained, retrieved through the processes, held against the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from services.retrieval.ease_grid import row_column
from services.retrieval.simulation.training_world import make_images
from shared.contracts import tables
from shared.contracts.schema import read_attributes, read_table, write_table
from tests.services.retrieval import small_world
from tests.services.retrieval.running import local, run

PLAN = small_world.PLAN
CUT_MS = PLAN.first_ms + 20 * small_world.DAY_MS
END_MS = PLAN.first_ms + 26 * small_world.DAY_MS


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw_if")
    (folder / "in").mkdir()
    small_world.write_surface(folder / "in/surface.nc")
    small_world.write_smap(folder / "in/smap.parquet")
    for stream, (name, span) in enumerate({"past": (PLAN.first_ms, CUT_MS), "later": (CUT_MS, END_MS)}.items()):
        points = small_world.points(*span, stream)
        write_table(folder / f"in/{name}.parquet", points, tables.SPECULAR_POINTS)
        write_table(folder / f"in/{name}_images.parquet", make_images(points, 0.18, 5), tables.AS_RUN)
    return folder


@pytest.fixture(scope="module")
def chain(root: Path) -> dict[str, dict[str, Any]]:
    seen = {
        name: run(
            root,
            "simulate-observations",
            specular_points={"href": f"in/{name}.parquet"},
            images={"href": f"in/{name}_images.parquet"},
            surface={"href": "in/surface.nc"},
            seed=seed,
        )
        for seed, name in enumerate(("past", "later"))
    }
    smap = {"href": "in/smap.parquet"}
    past = [seen["past"]["nominal"], seen["past"]["raw_if"]]
    trained = run(root, "train-soil-moisture", observations=past, soil_moisture=smap)
    later = {"observations": [seen["later"]["raw_if"]], "reference": trained["reference"]}
    return {
        "trained": trained,
        "modelled": run(root, "retrieve-soil-moisture", raw_if_model=trained["raw_if_model"], **later),
        "regressed": run(root, "retrieve-soil-moisture", **later),
    }


def _truth(table: pd.DataFrame) -> np.ndarray:
    """The nature's soil moisture of each cell-day: what the product is meant to say, without a sensor's noise."""
    surface = small_world.surface()
    latitude, longitude = np.meshgrid(surface.latitude_deg, surface.longitude_deg, indexing="ij")
    row, column = row_column(latitude.ravel(), longitude.ravel(), 9)
    day = (table["time"].dt.tz_localize(None).to_numpy().astype("datetime64[ms]").astype(np.int64) - PLAN.first_ms) // (
        small_world.DAY_MS
    )
    fields = {d: pd.Series(surface.soil_moisture[d].ravel()).groupby([row, column]).mean() for d in np.unique(day)}
    return np.array([fields[d][r, c] for d, r, c in zip(day, table["row"], table["column"], strict=True)])


def test_the_model_is_trained_and_travels_as_a_file(chain: dict[str, dict[str, Any]]) -> None:
    report = json.loads(local(chain["trained"]["report"]).read_text())["raw_if"]
    assert report["trained"] and report["method"] == "cqr" and report["cell_days"] >= 100 and report["sites"] >= 10
    assert local(chain["trained"]["raw_if_model"]).name == "raw_if_model.ubj"


def test_the_model_gives_other_intervals_than_the_regression(chain: dict[str, dict[str, Any]]) -> None:
    one, other = (read_table(local(chain[n]["soil_moisture"]), tables.SOIL_MOISTURE) for n in ("modelled", "regressed"))
    assert set(one["mode"]) == {"raw-if"} and len(one) == len(other) > 60
    assert not np.allclose(one["soil_moisture_sd"], other["soil_moisture_sd"])
    assert (
        (one["soil_moisture_low"] <= one["soil_moisture"]) & (one["soil_moisture"] <= one["soil_moisture_high"])
    ).all()
    assert json.loads(local(chain["modelled"]["report"]).read_text())["raw_if_by"] == "cqr"
    assert json.loads(local(chain["regressed"]["report"]).read_text())["raw_if_by"] == "regression"


def test_later_truths_lie_within_the_interval_and_the_estimates_follow_them(chain: dict[str, dict[str, Any]]) -> None:
    table = read_table(local(chain["modelled"]["soil_moisture"]), tables.SOIL_MOISTURE)
    truth = _truth(table)
    inside = ((truth >= table["soil_moisture_low"]) & (truth <= table["soil_moisture_high"])).mean()
    assert inside > 0.8
    assert np.abs(table["soil_moisture"] - truth).mean() < 0.05


def test_products_carry_counts_of_both_steps(chain: dict[str, dict[str, Any]]) -> None:
    counts = json.loads(read_attributes(local(chain["modelled"]["soil_moisture"]))["screening"])
    assert counts["raw-if"]["usable"] > 0 and counts["raw-if"]["read"] > counts["raw-if"]["usable"]
    assert set(counts["cell_days"]) == {"looks", "without_reference", "clipped"}


def test_a_coarser_grid_trains_a_model_too(root: Path, chain: dict[str, dict[str, Any]]) -> None:
    """Soil moisture of 9 km, regression on 36 km: the raw-IF looks meet the soil moisture of their own coarse cell."""
    seen = [{"href": path} for path in sorted(str(p) for p in root.rglob("nominal.nc"))][:1]
    raw = [{"href": path} for path in sorted(str(p) for p in root.rglob("raw_if.nc"))]
    smap = {"href": "in/smap.parquet"}
    made = run(
        root,
        "train-soil-moisture",
        observations=[*seen, *raw],
        soil_moisture=smap,
        resolution_km=36,
        soil_moisture_km=9,
    )
    report = json.loads(local(made["report"]).read_text())["raw_if"]
    assert report["cell_days"] > 60
