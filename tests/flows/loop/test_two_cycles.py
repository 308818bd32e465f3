"""Two cycles from orbital elements to a fire arrival map: contracts, cut-off, marks and lineage of what they made."""

from __future__ import annotations

import json
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import pystac
import pytest

from flows.catalogue import write_catalogue
from flows.comparison import local_file, read_reference
from flows.services import SERVICES
from shared.contracts import grids, tables
from shared.contracts.schema import read_attributes

if TYPE_CHECKING:
    from conftest import TinyLoop

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]

TABLES = [
    ("assemble-inputs", "incidents", tables.INCIDENTS),
    ("assemble-inputs", "detections", tables.DETECTIONS),
    ("rate-active-fires", "ratings", tables.RATINGS),
    ("build-targets", "targets", tables.TARGETS),
    ("predict-access", "opportunities", tables.OPPORTUNITIES),
    ("predict-access", "contacts", tables.CONTACTS),
    ("predict-access", "eclipses", tables.ECLIPSES),
    ("predict-access", "specular_points", tables.SPECULAR_POINTS),
    ("plan-observations", "schedule", tables.SCHEDULE),
    ("execute", "as_run", tables.AS_RUN),
    ("retrieve-burned-area", "burned_area", tables.BURNED_AREA),
    ("retrieve-soil-moisture", "soil_moisture", tables.SOIL_MOISTURE),
]


@pytest.mark.parametrize(("step", "output", "schema"), TABLES, ids=lambda value: getattr(value, "name", value))
def test_every_table_keeps_its_contract_and_says_it_is_simulated(
    tiny: TinyLoop, step: str, output: str, schema: Any
) -> None:
    for cycle in tiny.cycles:
        reference = cycle.steps[step][output]
        assert len(read_reference(reference, schema)) > 0
        attributes = read_attributes(local_file(reference))
        assert attributes["simulated"] is True
        assert attributes["oldest_input"]


def test_grids_keep_their_contracts(tiny: TinyLoop) -> None:
    for cycle in tiny.cycles:
        danger = grids.read_netcdf(local_file(cycle.steps["rate-prefire-danger"]["danger"]), grids.DANGER)
        maps = [
            grids.read_netcdf(local_file(reference), grids.FIRE_ARRIVAL, decode_times=False)
            for reference in cycle.steps["infer-fire-arrival"]["fire_arrival"]
        ]
        assert maps
        assert {dataset.attrs["simulated"] for dataset in [danger, *maps]} == {"true"}


def test_nothing_later_than_the_cut_off_enters(tiny: TinyLoop) -> None:
    for cycle in tiny.cycles:
        detections = read_reference(cycle.steps["assemble-inputs"]["detections"], tables.DETECTIONS)
        assert detections["delivered_at"].max() <= pd.Timestamp(cycle.cutoff)
        incidents = read_reference(cycle.steps["assemble-inputs"]["incidents"], tables.INCIDENTS)
        assert incidents["known_at"].max() <= pd.Timestamp(cycle.cutoff)
        burned = read_reference(cycle.steps["retrieve-burned-area"]["burned_area"], tables.BURNED_AREA)
        assert burned["time"].max() <= pd.Timestamp(cycle.end)
    assert len(read_reference(tiny.cycles[1].steps["assemble-inputs"]["incidents"], tables.INCIDENTS)) == 2


def test_raw_if_retrievals_come_only_from_images_that_were_downlinked(tiny: TinyLoop) -> None:
    for cycle in tiny.cycles:
        run = read_reference(cycle.steps["execute"]["as_run"], tables.AS_RUN)
        down = run[run["status"] == "downlinked"]
        assert (down["downlinked_at"] <= pd.Timestamp(cycle.end)).all()
        burned = read_reference(cycle.steps["retrieve-burned-area"]["burned_area"], tables.BURNED_AREA)
        seen = burned[burned["mode"] == "raw-if"]
        recorded = set(zip(down["satellite"], down["start"], strict=True))
        assert len(seen)
        assert set(zip(seen["satellite"], seen["time"], strict=True)) <= recorded


def test_commands_wait_for_the_uplink_and_the_old_plan_runs_on(tiny: TinyLoop) -> None:
    first, second = tiny.cycles
    for cycle in tiny.cycles:
        schedule = read_reference(cycle.steps["plan-observations"]["schedule"], tables.SCHEDULE)
        new = schedule[schedule["uplink_contact"] >= pd.Timestamp(cycle.cutoff)]
        release = pd.Timestamp(cycle.cutoff + timedelta(hours=tiny.profile.settings.release_after_h))
        assert (new["uplink_contact"] >= release).all()
        assert (new["start"] >= new["uplink_contact"]).all()
    assert second.steps["uplink"]["satellites_reached"] == 7
    assert first.steps["uplink"]["commands_still_in_force"] == 0


def test_the_catalogue_validates_and_leads_from_arrival_to_the_elements(tiny: TinyLoop) -> None:
    times = dict.fromkeys(("bundle", "calibration"), tiny.case.first_cutoff)
    times |= {cycle.label: cycle.cutoff for cycle in tiny.cycles}
    made: list[Any] = [tiny.inputs.inputs, tiny.inputs.nature, {"baseline": tiny.inputs.baseline}]
    made += [cycle.steps for cycle in tiny.cycles]
    path = write_catalogue(tiny.store, tiny.root, tiny.case.name, tiny.case.title, tiny.case.region, times, made)
    catalogue = pystac.Catalog.from_file(str(path))
    items = list(catalogue.get_items(recursive=True))
    assert len(items) >= 2 * 15
    for item in items:
        core_only = item.clone()
        core_only.stac_extensions = []  # their schemas lie on the network
        core_only.validate()
        for asset in item.assets.values():
            assert not asset.href.startswith(("/", "file:")), asset.href
            assert (Path(item.get_self_href()).parent / asset.href).resolve().is_file()
    last = tiny.cycles[-1].label
    arrival = next(item for item in items if item.id.startswith(f"{last}-infer-fire-arrival"))
    assert any("import-case" in identifier for identifier in _ancestors(arrival))


def _ancestors(item: pystac.Item) -> set[str]:
    seen: set[str] = set()
    waiting = [item]
    while waiting:
        current = waiting.pop()
        for link in current.get_links(pystac.RelType.DERIVED_FROM):
            source = pystac.Item.from_file(link.get_absolute_href())
            if source.id not in seen:
                seen.add(source.id)
                waiting.append(source)
    return seen


@pytest.mark.parametrize("service", SERVICES)
def test_one_correlation_id_follows_a_cycle_through_every_service(tiny: TinyLoop, service: str) -> None:
    log = (tiny.root / ".logs" / f"{service}.log").read_text()
    lines = [json.loads(line) for line in log.splitlines() if line.startswith("{")]
    for cycle in tiny.cycles:
        own = [line["event"] for line in lines if line.get("correlation_id") == f"test-{cycle.label}"]
        assert {"job accepted", "job ended"} <= set(own), own


def test_no_product_holds_an_absolute_path(tiny: TinyLoop) -> None:
    root = str(tiny.root).encode()
    for path in tiny.root.glob(f"{tiny.case.name}/*/*/*/*"):
        if path.is_file():
            assert root not in path.read_bytes(), path
