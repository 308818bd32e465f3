"""What a request may ask for beyond the usual: no targets, modes, footprints, heights, rolls, antennas, grids, maps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import rasterio

from services.access.ellipsoid import to_cartesian
from services.access.processes import PROCESSES
from services.access.specular.antenna import SHIPPED
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import read_table
from shared.errors import DomainError
from shared.process.execution import resolve_step, run_step, validate_inputs
from tests.services.access.orbits import START
from tests.services.access.staging import stage


def _run(root: Path, files: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    body = {**stage(root), "duration_s": 3600, "area": None, "with_specular_points": False, **changes}
    for name, content in (files or {}).items():
        if isinstance(content, pd.DataFrame):
            content.to_parquet(root / "in" / name)
        else:
            (root / "in" / name).write_text(json.dumps(content))
    store = ArtifactStore(Roots(str(root)))
    step = resolve_step(PROCESSES[0], validate_inputs(PROCESSES[0], body), store, "test")
    return run_step(step, store, "test", "job", lambda percent, message: None)


def _path(outputs: dict[str, Any], name: str) -> Path:
    return Path(outputs[name]["href"].removeprefix("file://"))


def _rows(outputs: dict[str, Any], name: str = "opportunities") -> pd.DataFrame:
    return read_table(_path(outputs, name), tables.OPPORTUNITIES)


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return _run(tmp_path_factory.mktemp("usual"), with_specular_points=True, with_figures=True)


def test_without_targets_there_are_tracks_contacts_and_eclipses(usual: dict[str, Any], tmp_path: Path) -> None:
    bare = _run(tmp_path, targets=None, with_specular_points=True)
    assert bare["opportunity_count"] == 0 and bare["revisit"] is None
    assert len(_rows(bare)) == 0
    for name in ("specular_points", "contacts", "eclipses"):
        assert bare[name]["sha256"] == usual[name]["sha256"], name
    least = _run(tmp_path / "least", targets=None)
    assert least["specular_points"] is None and least["contact_count"] == usual["contact_count"]


def test_tracks_have_every_column(usual: dict[str, Any]) -> None:
    points = read_table(_path(usual, "specular_points"), tables.SPECULAR_POINTS)
    assert set(points.columns) == {
        "satellite", "transmitter", "time", "geometry", "incidence_deg", "rx_gain_dbi", "rx_range_m", "tx_range_m",
        "nominal", "in_beam",
    }  # fmt: skip
    assert len(points) > 10_000 and points["incidence_deg"].between(0, 65).all()
    assert points["rx_range_m"].between(4.5e5, 1.3e6).all() and points["tx_range_m"].between(1.9e7, 2.7e7).all()


def test_images_hold_the_points_in_the_beams_or_the_nominal_channels(usual: dict[str, Any], tmp_path: Path) -> None:
    points = read_table(_path(usual, "specular_points"), tables.SPECULAR_POINTS)
    keys = ["satellite", "time", "transmitter"]
    in_beam = set(map(tuple, points.loc[points["in_beam"], keys].to_numpy()))
    nominal = set(map(tuple, points.loc[points["nominal"], keys].to_numpy()))
    raw_rows, nominal_rows = _rows(usual), _rows(_run(tmp_path, mode="nominal"))
    assert set(map(tuple, raw_rows[keys].to_numpy())) <= in_beam
    assert set(map(tuple, nominal_rows[keys].to_numpy())) <= nominal
    assert len(raw_rows) > 100 and len(nominal_rows) > 100
    assert (raw_rows["rx_gain_dbi"] > 0).all()


def test_robustness_columns_follow_age_or_what_is_given(usual: dict[str, Any], tmp_path: Path) -> None:
    rows = _rows(usual)
    mine = rows[rows["satellite"] == "CYGFM04"]["along_track_error_km"]
    assert mine.between(1.2, 1.4).all()  # 0.28 to 0.32 days old
    given = _rows(_run(tmp_path, along_track_error_km=30.0))
    assert (given["along_track_error_km"] == 30.0).all() and len(given) == len(rows)
    robust = [(some["covered_ahead"] & some["covered_behind"]).mean() for some in (rows, given)]
    assert 0.9 < robust[0] < 1.0 and 0.3 < robust[1] < robust[0] - 0.1
    report = json.loads(_path(usual, "report").read_text())
    assert report["counts"]["opportunities_robust"] == int((rows["covered_ahead"] & rows["covered_behind"]).sum())


def test_footprints_touch_more_than_two_kilometres_reach_and_less_than_25(tmp_path: Path) -> None:
    grid = {"spacing_deg": 0.15, "area": (-70.0, -34.0, -10.0, 34.0)}
    touched = _run(tmp_path / "a", targets=None, grid=grid, covered_by="footprint", duration_s=1800)
    wide, narrow = (
        _run(tmp_path / name, targets=None, grid=grid, target_radius_km=radius, duration_s=1800)["cells_covered"]
        for name, radius in (("b", 25.0), ("c", 2.0))
    )
    assert narrow < touched["cells_covered"] < wide
    report = json.loads(_path(touched, "report").read_text())
    assert report["method"]["covered_by"].startswith("first Fresnel zone")
    assert report["method"]["target_radius_km"] is None


def test_a_grid_gives_cells_rows_and_a_map_that_agree(tmp_path: Path) -> None:
    grid = {"spacing_deg": 1.0, "area": (100.0, -40.0, -100.0, 40.0), "land_only": True}
    found = _run(tmp_path, targets=None, grid=grid, target_radius_km=60.0, with_cell_opportunities=True)
    cells = pd.read_parquet(_path(found, "cells"))
    rows = _rows(found, "cell_opportunities")
    assert found["cells_covered"] == (cells["visits"] > 0).sum() == rows["target_id"].nunique() > 10
    assert cells.set_index("cell_id")["images"][rows["target_id"].unique()].sum() == len(rows)
    with rasterio.open(_path(found, "cell_coverage")) as raster:
        assert raster.crs.to_epsg() == 4326 and raster.descriptions == ("visits", "longest_wait_h", "mean_gap_h")
        visits = raster.read(1)
        assert raster.transform * (0, 0) == (100.0, 40.0)
    assert visits.shape == (80, 160)
    assert np.array_equal(visits[cells["row"], cells["column"]], cells["visits"])
    assert np.isfinite(visits).sum() == len(cells)


def test_cells_by_their_centres_are_what_targets_there_would_be(tmp_path: Path) -> None:
    latitude, longitude = (x.ravel() for x in np.meshgrid(np.arange(-30, 31, 4.0), np.arange(-180, 180, 4.0)))
    table = pd.DataFrame({"latitude_deg": latitude, "longitude_deg": longitude})
    found = _run(
        tmp_path, {"cells.parquet": table}, grid_cells={"href": "in/cells.parquet"}, with_cell_opportunities=True
    )
    assert found["cell_coverage"] is None
    cells = _rows(found, "cell_opportunities")
    assert len(cells) == json.loads(_path(found, "report").read_text())["counts"]["cell_opportunities"] > 50
    with pytest.raises(DomainError, match="both given"):
        _run(tmp_path / "x", {"cells.parquet": table}, grid_cells={"href": "in/cells.parquet"}, grid={"spacing_deg": 5})
    with pytest.raises(DomainError, match="no numbers in column longitude_deg"):
        bad = table.drop(columns="longitude_deg")
        _run(tmp_path / "y", {"cells.parquet": bad}, grid_cells={"href": "in/cells.parquet"})


def test_a_roll_and_an_antenna_change_the_gains_and_a_height_the_points(usual: dict[str, Any], tmp_path: Path) -> None:
    level = read_table(_path(usual, "specular_points"), tables.SPECULAR_POINTS)
    roll = pd.DataFrame({"satellite": ["CYGFM04"], "time": [pd.Timestamp(START)], "roll_deg": [15.0]})
    turned = _run(
        tmp_path / "r", {"roll.parquet": roll}, satellite_roll={"href": "in/roll.parquet"}, with_specular_points=True
    )
    rolled = read_table(_path(turned, "specular_points"), tables.SPECULAR_POINTS)
    mine = level["satellite"] == "CYGFM04"
    assert (rolled["rx_gain_dbi"] - level["rx_gain_dbi"])[mine].abs().max() > 5.0
    assert (rolled["rx_gain_dbi"] - level["rx_gain_dbi"])[~mine].abs().max() == 0.0

    system = json.loads((SHIPPED / "cygnss.json").read_text()) | {"name": "two channels", "channels": 2}
    two = _run(tmp_path / "a", {"antenna.json": system}, antenna={"href": "in/antenna.json"}, with_specular_points=True)
    points = read_table(_path(two, "specular_points"), tables.SPECULAR_POINTS)
    assert points.groupby(["satellite", "time"])["nominal"].sum().max() == 2

    high = _run(tmp_path / "h", surface_height_m=3000.0, with_specular_points=True)
    raised = read_table(_path(high, "specular_points"), tables.SPECULAR_POINTS)
    both = level.merge(pd.DataFrame(raised), on=["satellite", "transmitter", "time"], suffixes=("", "_high"))
    shift = np.linalg.norm(
        to_cartesian(both.geometry.y.to_numpy(), both.geometry.x.to_numpy())
        - to_cartesian(*(np.array([getattr(p, a) for p in both["geometry_high"]]) for a in ("y", "x"))),
        axis=1,
    )
    flat = (shift / (3000.0 * np.tan(np.radians(both["incidence_deg"]))))[both["incidence_deg"] > 20]
    assert len(both) > 10_000 and 0.4 < flat.quantile(0.01) < flat.median() < flat.quantile(0.99) < 1.05


def test_maps_and_revisit_are_written(usual: dict[str, Any]) -> None:
    assert _path(usual, "map").read_bytes()[:4] == b"\x89PNG"
    revisit = pd.read_parquet(_path(usual, "revisit"))
    rows = _rows(usual)
    images = rows.groupby("target_id").size()
    assert (revisit.set_index("target_id")["images"][images.index] == images).all()
    assert usual["targets_covered"] == (revisit["visits"] > 0).sum() == len(images)
    report = json.loads(_path(usual, "report").read_text())
    share = report["coverage"]["targets"]["share_within_km_by_day"]
    assert set(share) == {"3.5", "10", "25"} and share["3.5"][0] <= share["10"][0] <= share["25"][0]
    pairs = report["counts"]["pairs"]
    assert sum(pairs.values()) == 2 * 10 * 3600 and pairs["occulted"] > 0 and pairs["grazing_not_certified"] == 0
    assert report["revisit"]["targets"]["covered"] == usual["targets_covered"]
