"""Where the front is expected by the arrival map's own forecast, and the line that each fire gets."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from services.prioritization import active_targets, expected_front, fire_reports
from services.prioritization.expected_front import KINDS
from services.prioritization.lattice import Lattice
from shared.errors import DomainError

ACTIVE = Lattice("active", 5.0)


@pytest.fixture
def situation(make, time, area):
    return active_targets.Situation(time, 24.0, area, make["incidents"](), make["ratings"](), None, {}, [], None)


def _with_forecast(arrival, east_only: float, end=None):
    """Fire is sure to come within 10 km east of the burned area with that probability, and nowhere else."""
    burned = np.isfinite(arrival["fire_arrival_time"].to_numpy())
    x = arrival["x"].to_numpy() - arrival["x"].to_numpy().mean()
    y = arrival["y"].to_numpy() - arrival["y"].to_numpy().mean()
    ahead = ~burned & (x[None, :] > 0) & (np.hypot(x[None, :], y[:, None]) < 27000) & (np.abs(y)[:, None] < 8000)
    out = arrival.assign(front24_probability=(("y", "x"), np.where(ahead, east_only, 0.0)))
    return out if end is None else out.assign_attrs(end=end.isoformat())


def _ahead(front):
    return front.places.kind == KINDS.index("expected")


def test_the_maps_forecast_takes_the_rings_place(make, time):
    arrival = make["arrival"]()
    ring = expected_front.front_of_map(arrival, time, 24)
    front = expected_front.front_of_map(_with_forecast(arrival, 0.9), time, 24)
    assert front.forecast and not ring.forecast
    assert (front.places.longitude_deg[_ahead(front)] > -108.2).all() and _ahead(front).sum() > 100
    assert not (front.places.kind == KINDS.index("ring")).any()
    west = ring.places.longitude_deg[ring.places.kind == KINDS.index("ring")] < -108.2
    assert west.any()
    np.testing.assert_allclose(front.places.worth[_ahead(front)], 0.81, atol=1e-6)


def test_worth_ahead_rises_with_probability_and_values_doubt():
    p = np.linspace(0, 1, 101)
    worth = expected_front.ahead_of_forecast(p)
    assert worth[0] == 0 and worth[100] == pytest.approx(0.9)
    assert worth[50] == pytest.approx(0.7) and worth[10] > 0.9 * 0.1
    assert ((worth >= 0) & (worth <= 0.9)).all()


def test_a_longer_horizon_reaches_further_and_an_old_forecast_not_at_all(make, time):
    arrival = make["arrival"]()
    reference = expected_front.reference_time(arrival)
    fresh = _with_forecast(arrival, 0.3, end=time - pd.Timedelta(hours=3))
    one, two = (expected_front.front_forecast(fresh, reference, time, h) for h in (24, 48))
    assert one.max() == pytest.approx(0.3) and two.max() == pytest.approx(0.51)
    old = _with_forecast(arrival, 0.3, end=time - pd.Timedelta(hours=30))
    assert expected_front.front_forecast(old, reference, time, 24) is None
    assert not expected_front.front_of_map(old, time, 24).forecast


def test_a_forecast_in_per_cent_is_refused_by_name(make, time):
    with pytest.raises(DomainError) as caught:
        expected_front.front_of_map(_with_forecast(make["arrival"](), 60.0), time, 24)
    assert caught.value.field == "front24_probability"


def test_targets_follow_the_forecast(situation, make):
    mapped = replace(situation, arrival_maps={"A": _with_forecast(make["arrival"](), 0.9)})
    frame, report = active_targets.active_targets(mapped, ACTIVE)
    own = frame[frame["source"] == "incident:A"]
    outside = own[np.hypot((own["longitude_deg"] + 108.2) * 93, (own["latitude_deg"] - 33.2) * 111) > 20]
    assert len(outside) and (outside["longitude_deg"] > -108.2).all()
    assert "forecast of the front" in next(row for row in report if row["incident_id"] == "A")["reason"]


def test_each_line_says_rank_and_why(situation):
    _, report = active_targets.active_targets(situation, ACTIVE)
    assert [row["rank"] for row in report] == [1, 2]
    first = report[0]
    assert first["reason"].startswith("Alder, 1 of 2: r up to")
    assert "20.0 % (14.0 to 28.0 %)" in first["reason"] and "wind 9 m/s" in first["reason"]
    assert first["reason"].endswith("First rating.")
    assert first["priority_largest_low"] < first["priority_largest"] < first["priority_largest_high"]
    expected = 0.1 + 0.9 * np.sqrt(0.2) * first["worth_of_largest"] * first["staleness_of_largest"]
    assert first["priority_largest"] == pytest.approx(expected)


def _rated(make, time, hours_ago, **columns):
    table = make["ratings"]().assign(time=time - pd.Timedelta(hours=hours_ago), **columns)
    return table


def test_what_changed_is_told_with_its_causes(situation, make, time):
    before = _rated(make, time, 24, probability=[0.05, 0.04], wind_speed_m_s=[4.0, 5.0], kbdi_mm=[100.0, 40.0])
    now = _rated(make, time, 0, wind_speed_m_s=[11.0, 5.2], kbdi_mm=[101.0, 40.0])
    previous = fire_reports.Previous(
        fire_reports.previous_ratings(now, before, time), {"A": {"rank": 2, "targets": 3, "from_arrival_map": False}}
    )
    _, report = active_targets.active_targets(replace(situation, ratings=now, previous=previous), ACTIVE)
    lines = {row["incident_id"]: row["change"] for row in report}
    assert "probability 5.0 to 20.0 % in 24 h (wind +7.0 m/s)" in lines["A"]
    assert "rank 2 to 1" in lines["A"] and "places 3 to" in lines["A"]
    assert "4.0 % as before" in lines["B"] and "wind" not in lines["B"]


def test_the_previous_rating_is_the_one_before_the_latest(make, time):
    ratings = pd.concat([_rated(make, time, h, probability=[h / 100, 0.01]) for h in (0, 24, 48, -5)])
    assert fire_reports.latest_ratings(ratings, time)["A"]["probability"] == 0.0
    assert fire_reports.previous_ratings(ratings, None, time)["A"]["probability"] == 0.24
    only = ratings[ratings["time"] == time]
    assert fire_reports.previous_ratings(only, None, time) == {}
    older = _rated(make, time, 12, probability=[0.12, 0.01])
    assert fire_reports.previous_ratings(only, older, time)["A"]["probability"] == 0.12
    assert fire_reports.previous_ratings(only, only, time) == {}


def test_a_file_that_is_no_report_is_refused(room, make, time, area):
    (room.inputs / "x.json").write_text(json.dumps({"fires": "none"}))
    refs = {
        "incidents": room.table("incidents.parquet", make["incidents"](), "INCIDENTS"),
        "ratings": room.table("ratings.parquet", make["ratings"](), "RATINGS"),
        "danger": {"href": (room.inputs / "x.json").as_uri()},
        "previous_report": {"href": (room.inputs / "x.json").as_uri()},
    }
    with pytest.raises(DomainError) as caught:
        room.run("build-targets", time=time, area=area, **refs)
    assert caught.value.field == "previous_report"
