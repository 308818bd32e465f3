"""The spacecraft document: the fleet's values, each satellite's own, and what is refused."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import pytest
from pydantic import ValidationError

from shared.contracts.spacecraft import Spacecraft

FLEET: dict[str, Any] = {
    "storage_images": 15,
    "downlink_s_per_image": 120,
    "battery_capacity_wh": 30.0,
    "battery_min_wh": 20.0,
    "battery_initial_wh": 25.0,
    "generation_w": 38.0,
    "nominal_w": 20.0,
    "collect_w": 6.0,
    "downlink_w": 12.0,
    "horizon_start": "2024-07-01T00:00:00Z",
    "horizon_s": 86_400,
    "uplink_margin_s": 60,
    "satellites": {
        "CYGFM01": {"stored_images_initial": 3, "battery_initial_wh": 21.5, "uplink_margin_s": 0},
        "CYGFM05": {"unavailable": [{"start": "2024-07-01T01:00:00Z", "end": "2024-07-01T02:00:00Z"}]},
    },
}


def read(**changes: Any) -> Spacecraft:
    return Spacecraft.model_validate_json(json.dumps({**FLEET, **changes}))


def fields_at_fault(**changes: Any) -> set[str]:
    with pytest.raises(ValidationError) as caught:
        read(**changes)
    return {str(part) for item in caught.value.errors() for part in item["loc"]} | {str(caught.value)}


def test_a_satellite_has_its_own_values_or_the_fleet_s() -> None:
    fleet = read()
    own = fleet.for_satellite("CYGFM01")
    assert (own.stored_images_initial, own.battery_initial_wh, own.uplink_margin_s) == (3, 21.5, 0)
    assert own.unavailable == ()
    partly = fleet.for_satellite("CYGFM05")
    assert (partly.stored_images_initial, partly.battery_initial_wh, partly.uplink_margin_s) == (0, 25.0, 60)
    assert partly.unavailable[0].end == datetime(2024, 7, 1, 2, tzinfo=UTC)
    assert fleet.for_satellite("CYGFM08") == read(satellites={}).for_satellite("CYGFM01")


def test_what_a_step_adds_to_the_document_is_no_part_of_it() -> None:
    assert read(product={"process": "import", "simulated": True}) == read()


def test_defaults_of_what_may_be_left_out() -> None:
    short = {name: value for name, value in FLEET.items() if name not in ("uplink_margin_s", "satellites")}
    fleet = Spacecraft.model_validate(short)
    assert (fleet.uplink_margin_s, fleet.satellites) == (0, {})


@pytest.mark.parametrize("field", sorted(set(FLEET) - {"uplink_margin_s", "satellites"}))
def test_a_missing_field_is_named(field: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Spacecraft.model_validate({name: value for name, value in FLEET.items() if name != field})
    assert [item["loc"] for item in caught.value.errors()] == [(field,)]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("storage_images", 0),
        ("storage_images", 1.5),
        ("downlink_s_per_image", 0),
        ("battery_capacity_wh", 0),
        ("battery_capacity_wh", 24.0),  # less than the charge
        ("battery_min_wh", -1),
        ("battery_initial_wh", 19.9),  # below the floor
        ("battery_initial_wh", 30.1),  # above the capacity
        ("generation_w", -1),
        ("nominal_w", -1),
        ("collect_w", -1),
        ("downlink_w", -1),
        ("horizon_start", "2024-07-01T00:00:00"),  # whose time?
        ("horizon_s", -1),
        ("uplink_margin_s", -1),
        ("colour", "red"),
    ],
)
def test_a_bad_value_is_named(field: str, value: Any) -> None:
    assert any(field in part for part in fields_at_fault(**{field: value}))


@pytest.mark.parametrize(
    ("field", "state"),
    [
        ("stored_images_initial", {"stored_images_initial": -1}),
        ("battery_initial_wh", {"battery_initial_wh": -0.1}),
        ("uplink_margin_s", {"uplink_margin_s": -1}),
        ("end", {"unavailable": [{"start": "2024-07-01T01:00:00Z"}]}),
        ("start", {"unavailable": [{"start": "2024-07-01T01:00:00", "end": "2024-07-01T02:00:00Z"}]}),
        ("mood", {"mood": "good"}),
    ],
)
def test_a_satellite_s_bad_value_is_named_with_the_satellite(field: str, state: dict[str, Any]) -> None:
    assert {field, "CYGFM01"} <= fields_at_fault(satellites={"CYGFM01": state})


def test_a_copy_at_another_horizon_is_checked() -> None:
    later = read().at_horizon({"horizon_start": "2024-07-02T00:00:00Z", "horizon_s": 3600})
    assert later.horizon_start == datetime(2024, 7, 2, tzinfo=UTC)
    assert later.for_satellite("CYGFM01") == read().for_satellite("CYGFM01")
    with pytest.raises(ValidationError, match="battery_initial_wh 31"):
        read().at_horizon({"battery_initial_wh": 31.0})


def test_the_document_round_trips() -> None:
    assert Spacecraft.model_validate_json(read().model_dump_json()) == read()
