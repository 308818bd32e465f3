"""predict-access as a step: artifacts that keep their contracts, the same bytes twice, errors that name the fault."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from services.access.ellipsoid import arc_from_chord_m, to_cartesian
from services.access.events.contacts import Station
from services.access.orbits.formats import read_orbits
from services.access.prediction import AccessOptions, Horizon, predict
from services.access.processes import PROCESSES
from services.access.tables import opportunities_frame, specular_points_frame
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.contracts.schema import read_table, write_table
from shared.errors import DomainError
from shared.process.execution import resolve_step, run_step, validate_inputs
from tests.services.access.orbits import RECEIVERS, START, TRANSMITTERS
from tests.services.access.staging import HOURS, lattice, stage


def _run(root: Path, **changes: Any) -> dict[str, Any]:
    store = ArtifactStore(Roots(str(root)))
    inputs = validate_inputs(PROCESSES[0], {**stage(root), **changes})
    seen: list[float] = []
    outputs = run_step(
        resolve_step(PROCESSES[0], inputs, store, "test"), store, "test", "job", lambda percent, _: seen.append(percent)
    )
    assert seen == sorted(seen) and len(seen) >= 3
    return outputs


def _file(outputs: dict[str, Any], name: str) -> Path:
    return Path(outputs[name]["href"].removeprefix("file://"))


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return _run(tmp_path_factory.mktemp("first"))


def test_opportunities_are_what_the_specular_points_cover(outputs: dict[str, Any]) -> None:
    """Every row within the radius of the point it names; in the area, every pair of point and target has a row."""
    found = read_table(_file(outputs, "opportunities"), tables.OPPORTUNITIES)
    assert len(found) == outputs["opportunity_count"] > 1000
    assert (found["distance_km"] <= 60.0).all()
    assert found.groupby("image_id").agg(images=("satellite", "nunique"), times=("time", "nunique")).eq(1).all().all()
    assert outputs["image_count"] == found["image_id"].nunique() == found["image_id"].max() + 1
    points = read_table(_file(outputs, "specular_points"), tables.SPECULAR_POINTS)
    targets = lattice()
    ours = found.merge(points, on=["satellite", "transmitter", "time"], suffixes=("", "_point"))
    place = targets.set_index("target_id").geometry.loc[ours["target_id"]]
    chord = np.linalg.norm(
        to_cartesian(place.y.to_numpy(), place.x.to_numpy())
        - to_cartesian(points.geometry.y, points.geometry.x)[_rows(points, ours)],
        axis=1,
    )
    assert len(ours) > 50
    assert np.abs(arc_from_chord_m(chord) / 1000.0 - ours["distance_km"]).max() < 1e-6
    assert np.allclose(ours["rx_gain_dbi"], ours["rx_gain_dbi_point"])


def _rows(points: pd.DataFrame, ours: pd.DataFrame) -> np.ndarray:
    keys = ["satellite", "transmitter", "time"]
    index = pd.MultiIndex.from_frame(points[keys])
    return np.asarray(index.get_indexer(pd.MultiIndex.from_frame(ours[keys])))


def test_specular_points_keep_to_the_area_across_the_dateline(outputs: dict[str, Any]) -> None:
    points = read_table(_file(outputs, "specular_points"), tables.SPECULAR_POINTS)
    longitude = points.geometry.x
    assert ((longitude >= 170.0) | (longitude <= -120.0)).all()
    assert (longitude > 0).any() and (longitude < 0).any()
    per_second = points.groupby(["satellite", "time"])["nominal"].sum()
    assert per_second.max() == 4
    everywhere = read_orbits(RECEIVERS), read_orbits(TRANSMITTERS)
    options = AccessOptions(with_specular_points=True)
    globe = specular_points_frame(predict(*everywhere, [], _positions(), Horizon(START, HOURS * 3600), options))
    boxed = (globe.geometry.x >= 170.0) | (globe.geometry.x <= -120.0)
    within = globe[boxed & (globe.geometry.y.abs() <= 35.0)]
    assert len(within) == len(points)


def _positions() -> tuple[np.ndarray, np.ndarray]:
    targets = lattice()
    return targets.geometry.y.to_numpy(), targets.geometry.x.to_numpy()


def test_contacts_eclipses_and_report_keep_their_contracts(outputs: dict[str, Any]) -> None:
    contacts = read_table(_file(outputs, "contacts"), tables.CONTACTS)
    eclipses = read_table(_file(outputs, "eclipses"), tables.ECLIPSES)
    assert len(contacts) == outputs["contact_count"] > 0
    assert (contacts["end"] > contacts["start"]).all() and (contacts["max_elevation_deg"] >= 7.0).all()
    assert set(eclipses["kind"]) == {"umbra", "penumbra"}
    report = json.loads(_file(outputs, "report").read_text())
    old, new = report["receivers"]
    assert (old["satellite"], old["age_days"], old["newer_than_start"]) == ("CYGFM04", 0.276, False)
    assert (new["satellite"], new["age_days"], new["newer_than_start"]) == ("CYGFM05", -0.061, True)
    assert report["transmitters"][0]["expected_position_error_km"]["median_km"] == 1.3
    newer = [row["satellite"] for row in report["receivers"] + report["transmitters"] if row["newer_than_start"]]
    assert len(newer) == 10 and [line.split(":")[0] for line in report["warnings"]] == newer
    assert report["counts"]["opportunities"] == outputs["opportunity_count"]
    assert report["specular_angle_max_deg"] < 1e-6


def test_the_same_inputs_give_the_same_bytes(outputs: dict[str, Any], tmp_path: Path) -> None:
    again = _run(tmp_path)
    for name in ("opportunities", "contacts", "eclipses", "specular_points", "report"):
        assert again[name]["sha256"] == outputs[name]["sha256"], name


def test_a_longer_step_keeps_the_images_of_the_shorter(outputs: dict[str, Any]) -> None:
    targets = lattice()
    horizon = Horizon(START, HOURS * 3600, 30)
    access = predict(read_orbits(RECEIVERS), read_orbits(TRANSMITTERS), [], _positions(), horizon, AccessOptions(60.0))
    coarse = opportunities_frame(access, targets["target_id"].to_numpy())
    fine = read_table(_file(outputs, "opportunities"), tables.OPPORTUNITIES)
    same = fine[(fine["time"] - pd.Timestamp(START)).dt.total_seconds() % 30 == 0]
    keys = ["satellite", "time", "target_id"]
    assert set(map(tuple, coarse[keys].to_numpy())) == set(map(tuple, same[keys].to_numpy()))


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"step_s": 7}, "step_s"),
        ({"start": "2022-12-04T00:00:00.5Z"}, "start"),
        ({"start": "2024-12-04T00:00:00Z"}, "receivers"),
        ({"area": (10.0, 20.0, 30.0, 20.0)}, "area"),
        ({"transmitters": {"href": "in/receivers.tle"}}, "transmitters"),
    ],
)
def test_bad_input_is_named_and_leaves_nothing(tmp_path: Path, changes: dict[str, Any], field: str) -> None:
    with pytest.raises(DomainError) as caught:
        _run(tmp_path, **changes)
    assert caught.value.field == field
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.parent.name != "in"]


def test_old_elements_warn_and_stale_ones_are_left_out(tmp_path: Path) -> None:
    aged = _run(tmp_path / "aged", start="2022-12-14T00:00:00Z", duration_s=600, with_specular_points=False)
    assert aged["specular_points"] is None
    report = json.loads(_file(aged, "report").read_text())
    assert sum("CYGFM" in warning for warning in report["warnings"]) == 2
    strict = _run(tmp_path / "strict", duration_s=600, max_element_age_days=0.25, area=None)
    report = json.loads(_file(strict, "report").read_text())
    assert "CYGFM04" in report["dropped"]


def test_empty_tables_are_named_or_answered(tmp_path: Path) -> None:
    two = read_orbits(RECEIVERS), read_orbits(TRANSMITTERS)
    with pytest.raises(DomainError, match="targets: the table is empty"):
        predict(*two, [], (np.array([]), np.array([])), Horizon(START, 600), AccessOptions())
    nowhere = predict(
        *two, [Station("pole", 90, 0, 0)], (np.array([80.0]), np.array([0.0])), Horizon(START, 600), AccessOptions()
    )
    assert len(opportunities_frame(nowhere, np.array([1]))) == 0
    write_table(tmp_path / "none.parquet", opportunities_frame(nowhere, np.array([1])), tables.OPPORTUNITIES)
