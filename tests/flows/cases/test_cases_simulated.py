"""The simulated case: same seed, same bytes; detections that obey the fire; nothing of nature among the inputs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pyproj import Transformer
from sgp4 import omm
from sgp4.api import Satrec

from flows.cases.bundle import Case
from flows.cases.scoring import ArrivalField, read_arrival, truth_incidents
from flows.cases.simulated import SIZES, build_simulated_case, setting_of
from shared.contracts import tables
from shared.contracts.schema import read_table
from shared.contracts.spacecraft import Spacecraft
from shared.errors import DomainError


def _truths(case: Case) -> dict[str, ArrivalField]:
    path = case.path("truth")
    return {name: read_arrival(path, f"fire_arrival_time_{name}") for name in truth_incidents(path)}


def test_the_same_seed_gives_the_same_bytes(tiny: Case, tmp_path: Path) -> None:
    again = build_simulated_case("tiny", tmp_path)
    names = sorted(path.name for path in tiny.folder.iterdir())
    assert names == sorted(path.name for path in again.folder.iterdir())
    for name in names:
        assert (tiny.folder / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_another_seed_gives_another_nature(tiny: Case, tmp_path: Path) -> None:
    other = build_simulated_case("tiny", tmp_path, seed=7)
    for logical in ("detections", "weather_analysis", "fuels", "surface", "truth"):
        assert other.path(logical).read_bytes() != tiny.path(logical).read_bytes(), logical
    assert other.path("receivers").read_bytes() == tiny.path("receivers").read_bytes()


def test_unknown_size_names_the_known() -> None:
    with pytest.raises(DomainError) as caught:
        setting_of("huge")
    assert all(size in caught.value.accepted for size in SIZES)


def test_nature_is_apart_from_the_inputs_and_marked(tiny: Case) -> None:
    assert set(tiny.nature) == {"surface", "truth"}
    assert not set(tiny.nature) & set(tiny.inputs)
    assert not {path.name for path in tiny.nature.values()} & {path.name for path in tiny.inputs.values()}
    real = {name for name, origin in tiny.provenance.items() if not origin.simulated}
    assert real == {"receivers", "transmitters", "stations", "spacecraft"}


def test_tables_obey_their_contracts(tiny: Case) -> None:
    assert len(read_table(tiny.path("stations"), tables.STATIONS)) == 3
    assert len(read_table(tiny.path("incidents"), tables.INCIDENTS)) == 2
    assert len(read_table(tiny.path("detections"), tables.DETECTIONS)) > 1000
    model = Spacecraft.model_validate_json(tiny.path("spacecraft").read_bytes())
    assert (model.storage_images, model.downlink_s_per_image) == (60, 20)


def test_elements_load_in_sgp4_and_were_known_at_the_cutoff(tiny: Case) -> None:
    for logical, count in (("receivers", 7), ("transmitters", 31)):
        elements = json.loads(tiny.path(logical).read_text())
        assert len(elements) == count
        for fields in elements:
            satellite = Satrec()
            omm.initialize(satellite, fields)
            error, position, _ = satellite.sgp4(2460919.5, 0.0)
            assert error == 0
            assert np.linalg.norm(position) > 6700
            assert pd.Timestamp(fields["EPOCH"], tz="UTC") <= pd.Timestamp(tiny.first_cutoff)
    names = [fields["OBJECT_NAME"] for fields in json.loads(tiny.path("transmitters").read_text())]
    codes = {name.split("(PRN ")[1].rstrip(")") for name in names}
    assert len(codes) == 31


def test_no_detection_before_the_fire_arrives(tiny: Case) -> None:
    detections = read_table(tiny.path("detections"), tables.DETECTIONS)
    fires = detections[detections.fire]
    explained = np.zeros(len(fires), dtype=bool)
    for truth in _truths(tiny).values():
        x, y = Transformer.from_crs(4326, truth.crs, always_xy=True).transform(fires.geometry.x, fires.geometry.y)
        rows, columns = np.nonzero(np.isfinite(truth.arrival_s))
        cells_x, cells_y, arrival = truth.x_m[columns], truth.y_m[rows], truth.arrival_s[rows, columns]
        for number, (east, north, when, along, across) in enumerate(
            zip(x, y, fires.time, fires.along_m, fires.across_m, strict=True)
        ):
            inside = np.hypot(cells_x - east, cells_y - north) <= 0.5 * np.hypot(along, across) + 250.0
            explained[number] |= bool((arrival[inside] <= truth.seconds(when) + 1.0).any())
    assert explained.all()


def test_detections_are_delivered_within_six_hours(tiny: Case) -> None:
    detections = read_table(tiny.path("detections"), tables.DETECTIONS)
    delay = detections.delivered_at - detections.time
    assert (delay > pd.Timedelta(0)).all() and (delay <= pd.Timedelta(hours=6)).all()
    assert (detections.groupby(["time", "satellite"]).delivered_at.nunique() == 1).all()
    passes = detections.groupby(detections.time.dt.date).time.nunique()
    assert 4 <= passes.iloc[1:-1].mean() <= 8


def test_looks_give_no_fire_away_before_it_starts(tiny: Case) -> None:
    """Before the second fire starts, its surroundings are looked at no more densely than the rest of the region."""
    detections = read_table(tiny.path("detections"), tables.DETECTIONS)
    incident = read_table(tiny.path("incidents"), tables.INCIDENTS).set_index("incident_id").loc["SIM002"]
    first = read_table(tiny.path("incidents"), tables.INCIDENTS).set_index("incident_id").loc["SIM001"]
    early = detections[detections.time < incident.start]

    def near(point) -> int:
        gap = np.hypot((early.geometry.x - point.x) * 0.83, early.geometry.y - point.y)
        return int((gap < 0.1).sum())

    assert near(first.geometry) > 5 * near(incident.geometry)
    assert not early[np.hypot(early.geometry.x + 109.6, early.geometry.y - 34.16) < 0.1].fire.any()


def test_some_of_the_burning_pixels_are_missed_and_clouds_hide(tiny: Case) -> None:
    detections = read_table(tiny.path("detections"), tables.DETECTIONS)
    truth = _truths(tiny)["SIM001"]
    looks = detections[(detections.instrument == "VIIRS") & (detections.time > tiny.first_cutoff)]
    x, y = Transformer.from_crs(4326, truth.crs, always_xy=True).transform(looks.geometry.x, looks.geometry.y)
    column = np.rint((x - truth.x_m[0]) / 250).astype(int)
    row = np.rint((y - truth.y_m[0]) / 250).astype(int)
    inside = (row >= 0) & (row < len(truth.y_m)) & (column >= 0) & (column < len(truth.x_m))
    age = np.full(len(looks), np.nan)
    clock = np.array([truth.seconds(time) for time in looks.time])
    age[inside] = clock[inside] - truth.arrival_s[row[inside], column[inside]]
    hot = (age > 600) & (age < 7.5 * 3600)
    assert (~looks.fire[hot]).any()
    lattice = detections[~detections.fire & (detections.time < "2025-08-30T22:00Z")].groupby("time").size()
    assert (lattice < 81).any()  # the wide lattice has 81 places; cloud takes some


def test_incidents_are_known_after_they_start_and_reported_coarsely(tiny: Case) -> None:
    incidents = read_table(tiny.path("incidents"), tables.INCIDENTS)
    assert (incidents.known_at > incidents.start).all()
    reports = pd.read_parquet(tiny.path("incident_reports"))
    truths = _truths(tiny)
    ratios = []
    for report in reports.itertuples():
        area = truths[report.incident_id].burned_by(report.known_at).sum() * 0.0625
        ratios.append(report.area_km2 / max(area, 0.1))
    assert 0.4 < np.median(ratios) < 1.2
    assert np.std(ratios) > 0.05


def test_a_fire_starts_on_the_second_day(tiny: Case) -> None:
    incidents = read_table(tiny.path("incidents"), tables.INCIDENTS)
    known = incidents.known_at
    assert (known <= pd.Timestamp(tiny.cutoff(1))).any()
    assert ((known > pd.Timestamp(tiny.cutoff(1))) & (known <= pd.Timestamp(tiny.cutoff(2)))).any()


def test_fires_stay_inside_their_windows(tiny: Case) -> None:
    for truth in _truths(tiny).values():
        edge = np.concatenate([truth.arrival_s[[0, -1]].ravel(), truth.arrival_s[:, [0, -1]].ravel()])
        assert np.isnan(edge).all()
        assert truth.burned_by(tiny.cutoff(3)).sum() * truth.cell_km2 > 5.0
