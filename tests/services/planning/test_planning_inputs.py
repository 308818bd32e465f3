"""Bad input is refused with the field at fault; impossible mandatory targets are explained."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from services.planning.operations import make_plan
from services.planning.planner import Options
from services.planning.spacecraft_limits import read_spacecraft
from shared.errors import DomainError
from tests.services.planning.planning_cases import CRAFT, Case, at

CASE = Case(
    [(0, "CYGFM01", 1, [1]), (1, "CYGFM01", 2, [2]), (2, "CYGFM01", 3, [3])],
    {1: ("active", 3.0), 2: ("active", 2.0), 3: ("active", 1.0), 4: ("active", 1.0), 5: ("prefire", 1.0)},
    [("CYGFM01", "hawaii", 6, 9)], craft={"battery_initial_wh": 10.0},
)  # fmt: skip


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"contacts": [("CYGFM01", "hawaii", 6, 9), ("CYGFM01", "hawaii", 8, 10)]}, "contacts.start"),
        ({"images": [(0, "CYGFM01", 1, [99])]}, "opportunities.target_id"),
        ({"images": [(0, "CYGFM01", 1.5, [1])]}, "opportunities.time"),
        ({"images": [(0, "CYGFM01", 1, [1]), (1, "CYGFM01", 1, [2])]}, "opportunities.image_id"),
        ({"rewards": {1: ("active", -3.0), 2: ("active", 1.0), 3: ("prefire", 1.0)}}, "targets.priority"),
        ({"rewards": {1: ("active", float("nan")), 2: ("active", 1.0), 3: ("prefire", 1.0)}}, "targets.priority"),
        ({"craft": {"horizon_s": 0}}, "spacecraft.horizon_s"),
        ({"craft": {"satellites": {"CYGFM01": {"battery_initial_wh": 1.0}}}}, "spacecraft.battery_initial_wh"),
        ({"craft": {"satellites": {"CYGFM01": {"stored_images_initial": 3}}}}, "spacecraft.stored_images_initial"),
        ({"eclipses": [("CYGFM01", 0, 14)], "craft": {"battery_initial_wh": 8.0}}, "spacecraft.battery_min_wh"),
    ],
)
def test_bad_input_names_its_field(change: dict[str, Any], field: str) -> None:
    case = replace(CASE, **change)
    with pytest.raises(DomainError) as caught:
        make_plan(case.tables, case.spacecraft)
    assert caught.value.field == field


def test_a_bad_spacecraft_document_names_its_field() -> None:
    with pytest.raises(DomainError) as caught:
        read_spacecraft({**CRAFT, "storage_images": 0})
    assert caught.value.field == "spacecraft.storage_images"
    with pytest.raises(DomainError, match="battery_initial_wh"):
        read_spacecraft({**CRAFT, "battery_initial_wh": 1.0})


def test_unmet_active_targets_are_named_with_their_reason() -> None:
    made = make_plan(CASE.tables, CASE.spacecraft, options=Options(mip_gap=0.0))
    reasons = {row["target_id"]: row["reason"] for row in made.report["active_targets_not_observed"]}
    mandatory = made.report["active_mandatory"]
    assert (mandatory["held"], mandatory["possible"]) == (False, False)
    assert reasons == {3: "crowded out: storage of CYGFM01 in cycle 0", 4: "no opportunity"}
    assert made.plan.objective == pytest.approx(50.0)
    late = make_plan(CASE.tables, CASE.spacecraft, release=at(0).to_pydatetime())
    assert "a command can reach" in late.report["active_targets_not_observed"][0]["reason"]


def test_demanding_the_impossible_is_refused() -> None:
    with pytest.raises(DomainError) as caught:
        make_plan(CASE.tables, CASE.spacecraft, options=Options(active_mandatory="true"))
    assert caught.value.field == "active_mandatory"


def test_nothing_to_see_is_an_empty_plan() -> None:
    empty = replace(CASE, images=[], rewards={})
    made = make_plan(empty.tables, empty.spacecraft)
    assert made.schedule.empty
    assert made.plan.objective == made.plan.bound == made.plan.gap == 0.0


def test_nothing_at_all_is_planned_as_nothing() -> None:
    case = Case([], {}, [])
    made = make_plan(case.tables, case.spacecraft)
    assert made.plan.objective == 0 and not len(made.schedule)


def test_a_full_store_without_contacts_takes_no_image_of_many() -> None:
    rng = np.random.default_rng(0)
    shots = [(i, "CYGFM01", float(i), sorted(rng.choice(800, 25, replace=False).tolist())) for i in range(700)]
    full = {"storage_images": 2, "satellites": {"CYGFM01": {"stored_images_initial": 2}}, "horizon_s": 800}
    case = Case(shots, dict.fromkeys(range(800), ("prefire", 1.0)), [], craft={"battery_initial_wh": 10.0, **full})
    made = make_plan(case.tables, case.spacecraft, price=False, options=Options(work_limit=0.3))
    assert made.plan.objective == 0 and made.plan.bound == pytest.approx(0, abs=1e-3)
