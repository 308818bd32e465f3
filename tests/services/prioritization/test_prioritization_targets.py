"""Targets: one scale, ids that stay, and feedback that really changes them."""

from __future__ import annotations

from dataclasses import replace

import geopandas
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Point, box

from services.prioritization import active_targets, expected_front, observation_age, reward, targets, weather
from services.prioritization.lattice import Lattice
from services.prioritization.prefire import conditions, danger, danger_run, fuels
from shared.contracts import tables
from shared.errors import DomainError

ACTIVE, PREFIRE = Lattice("active", 5.0), Lattice("prefire", 0.1)


@pytest.fixture(scope="module")
def grid_parts():
    return {}


@pytest.fixture
def grid(make, time, grid_parts):
    if "grid" not in grid_parts:
        vegetation = fuels.fuels_from_dataset(make["fuels"](0.1))
        air = weather.weather_from_dataset(make["weather"](hours=48))
        daily = conditions.daily_conditions(air, None, time)
        seen = danger.seen_land(vegetation.grid, [], [], time, danger.DangerEffects())
        grid_parts["grid"] = danger_run.rate(vegetation, daily, seen, time).grid
    return grid_parts["grid"]


@pytest.fixture
def situation(make, time, area):
    return active_targets.Situation(
        time=time,
        horizon_h=24.0,
        area=area,
        incidents=make["incidents"](),
        ratings=make["ratings"](),
        detections=None,
        arrival_maps={},
        burned_area=[],
        observed=None,
    )


def _detections(time, places, hours_ago=3.0, delay_h=1.0, fire=True) -> geopandas.GeoDataFrame:
    when = time - pd.Timedelta(hours=hours_ago)
    n = len(places)
    return geopandas.GeoDataFrame(
        {"time": [when] * n, "delivered_at": [when + pd.Timedelta(hours=delay_h)] * n, "fire": [fire] * n},
        geometry=[Point(*place) for place in places],
        crs="EPSG:4326",
    )


def _active(situation):
    return active_targets.active_targets(situation, ACTIVE)


@settings(max_examples=100, deadline=None)
@given(p=st.floats(0, 1), w=st.floats(0, 1), s=st.floats(0, 1), wfsp=st.floats(0, 100), wlfp=st.floats(0, 1e4))
def test_ten_times_any_active_exceeds_any_prefire(p, w, s, wfsp, wlfp):
    active = reward.active_reward(np.array(p), np.array(w), np.array(s))
    prefire = reward.prefire_reward(reward.danger_worth(np.array(wfsp), np.array(wlfp)), np.array(s))
    assert 0.1 <= active <= 1 and 0 <= prefire <= 0.9
    assert 10 * active > prefire


def test_staleness_recovers_with_time():
    values = reward.staleness(np.array([0.0, 24.0, 1e6, np.nan]), "active")
    assert values[0] == pytest.approx(0.3)
    assert values[1] == pytest.approx(1 - 0.7 * np.exp(-1))
    assert values[2] == values[3] == 1


@settings(max_examples=100, deadline=None)
@given(longitude=st.floats(-180, 179.99), latitude=st.floats(-75, 75))
def test_lattice_finds_its_own_centres(longitude, latitude):
    for lattice in (ACTIVE, PREFIRE):
        row, column = lattice.locate(np.array([longitude]), np.array([latitude]))
        x, y = lattice.centre(row, column)
        assert abs(y[0] - latitude) <= lattice.height_deg / 2 + 1e-6
        again = lattice.locate(x, y)
        assert (again[0][0], again[1][0]) == (row[0], column[0])


def test_ids_differ_between_kinds_spacings_and_places():
    ids = set()
    for lattice in (ACTIVE, PREFIRE, Lattice("active", 4.0), Lattice("prefire", 0.2)):
        x, y = np.meshgrid(np.arange(-110, -109, 0.3), np.arange(33, 34, 0.3))
        ids.update(lattice.target_id(*lattice.locate(x.ravel(), y.ravel())).tolist())
    assert len(ids) == 4 * 16
    assert max(ids) < 2**63


def test_unusable_spacing_is_named():
    with pytest.raises(DomainError) as caught:
        Lattice("active", 0.01)
    assert caught.value.field == "active_spacing_km"


def test_build_meets_the_contract_and_repeats(situation, grid):
    first, report = targets.build(situation, grid, ACTIVE, PREFIRE)
    second, _ = targets.build(situation, grid, ACTIVE, PREFIRE)
    pd.testing.assert_frame_equal(first, second)
    checked = tables.TARGETS.check(first)
    assert (checked["priority_low"] <= checked["priority"]).all()
    assert (checked["priority"] <= checked["priority_high"]).all()
    active, prefire = (checked.loc[checked["kind"] == kind, "priority"] for kind in ("active", "prefire"))
    assert 10 * active.min() > prefire.max()
    assert [fire["rank"] for fire in report["fires"]] == [1, 2]
    assert "imputed: kbdi_mm" in report["fires"][1]["reason"]


def test_prefire_follows_danger_and_leaves_masks_out(situation, grid):
    frame, report = targets.build(situation, grid, ACTIVE, PREFIRE)
    prefire = frame[frame["kind"] == "prefire"]
    assert prefire.geometry.y.min() > 32.2  # the band of agriculture
    west, east = prefire[prefire.geometry.x < -108.5], prefire[prefire.geometry.x > -106.5]
    assert west["priority"].mean() > east["priority"].mean()  # green in the east
    assert report["prefire"]["grid_cells_masked_or_unknown"] > 0
    alder = Point(-108.2, 33.2)
    assert (
        np.hypot(prefire.geometry.x - alder.x, prefire.geometry.y - alder.y).min() > 0.04
    )  # that place is an active target


def test_ids_stay_when_the_source_changes(make, situation):
    before, _ = _active(situation)
    after, _ = _active(replace(situation, arrival_maps={"A": make["arrival"]()}))
    common = set(before["target_id"]) & set(after["target_id"])
    assert len(common) >= 3
    places = [f.set_index("target_id").loc[sorted(common), ["longitude_deg", "latitude_deg"]] for f in (before, after)]
    pd.testing.assert_frame_equal(*places)


def test_arrival_map_moves_targets_to_the_front(make, situation):
    frame, fires = _active(replace(situation, arrival_maps={"A": make["arrival"]()}))
    alder = frame[frame["source"] == "incident:A"]
    distance = 111.195 * np.hypot(
        (alder["longitude_deg"] + 108.2) * np.cos(np.radians(33.2)), alder["latitude_deg"] - 33.2
    )
    by_worth = alder.assign(distance=distance).sort_values("worth")
    assert by_worth["distance"].iloc[-5:].between(10, 22).all()  # the front stands at 17.3 km
    assert fires[0]["spread_m_s"] == pytest.approx(0.1, rel=0.02)  # as the map was made
    assert fires[0]["from_arrival_map"] and fires[0]["targets_by_kind"]["ring"] > 5
    assert distance.max() < 17.3 + 8.64 + 5  # no further than a day at that rate, and a cell


def test_old_fire_keeps_its_front_and_loses_its_inside(make, situation):
    frame, _ = _active(replace(situation, arrival_maps={"A": make["arrival"](days=3.0)}))
    alder = frame[frame["source"] == "incident:A"]
    centre = np.hypot(alder["longitude_deg"] + 108.2, alder["latitude_deg"] - 33.2) < 0.04
    assert alder.loc[centre, "worth"].max() < 0.2 or not centre.any()


def test_uncertain_places_gain_worth(make, situation):
    sure = make["arrival"]()
    unsure = sure.copy(deep=True)
    inside = (np.abs(unsure.x - unsure.x.mean()) < 4000) & (np.abs(unsure.y - unsure.y.mean()) < 4000)
    unsure["fire_arrival_time_sd"] = unsure["fire_arrival_time_sd"].where(~inside, 12 * 3600.0)
    a, b = (expected_front.front_of_map(m, situation.time, 24).places.worth.sum() for m in (sure, unsure))
    assert b > a


def test_detections_make_targets_only_once_delivered(situation, time, grid):
    away = [(-108.1, 33.25), (-108.05, 33.25)]
    none, _ = _active(situation)
    some, _ = _active(replace(situation, detections=_detections(time, away)))
    late, _ = _active(replace(situation, detections=_detections(time, away, hours_ago=3, delay_h=6)))
    _, report = targets.build(replace(situation, detections=_detections(time, [(-106.3, 32.5)])), grid, ACTIVE, PREFIRE)
    assert report["recent_detections_far_from_incidents"] == 1
    looked, _ = _active(replace(situation, detections=_detections(time, away, fire=False)))
    old, _ = _active(replace(situation, detections=_detections(time, away, hours_ago=60)))
    assert len(some) > len(none)
    for frame in (late, looked, old):
        pd.testing.assert_frame_equal(frame, none)


def test_burned_area_takes_the_inside_away(make, situation):
    with_map = replace(situation, arrival_maps={"A": make["arrival"]()})
    plain, _ = _active(with_map)
    table = make["burned_area"](-108.2, 33.317, 13)
    burned, fires = _active(replace(with_map, burned_area=[table]))
    later, _ = _active(replace(with_map, burned_area=[make["burned_area"](-108.2, 33.317, -2)]))
    pd.testing.assert_frame_equal(plain, later)  # not known yet
    assert fires[0]["targets_removed_as_burned"] >= 1
    near = {
        i
        for i, x, y in plain[["target_id", "longitude_deg", "latitude_deg"]].itertuples(index=False)
        if np.hypot(x + 108.2, y - 33.317) < 0.025
    }
    assert near and not near & set(burned["target_id"])


def test_fresh_looks_lower_the_reward_and_gaps_recover(situation, grid, time):
    place = pd.DataFrame({"longitude_deg": [-108.2, -107.05], "latitude_deg": [33.2, 33.05]})

    def build(hours_ago: float) -> pd.Series:
        observed = place.assign(time=time - pd.Timedelta(hours=hours_ago))
        frame, _ = targets.build(replace(situation, observed=observed), grid, ACTIVE, PREFIRE)
        return frame.set_index("target_id")["priority"]

    never = targets.build(situation, grid, ACTIVE, PREFIRE)[0].set_index("target_id")["priority"]
    fresh, stale, future = build(1), build(200), build(-1)
    seen = fresh.index[fresh < 0.8 * never[fresh.index]]
    assert 2 <= len(seen) <= 12
    assert (stale[seen] > fresh[seen]).all()
    pd.testing.assert_series_equal(future, never)


def test_more_probable_fires_earn_more(make, situation):
    base, _ = _active(situation)
    likely, fires = _active(replace(situation, ratings=make["ratings"]((0.2, 0.5))))
    of_b = [f.loc[f["source"] == "incident:B", "priority"].max() for f in (base, likely)]
    assert of_b[1] > of_b[0]
    assert [fire["incident_id"] for fire in fires] == ["B", "A"]


def test_unrated_fire_still_gets_targets_with_a_wide_interval(make, situation):
    frame, fires = _active(replace(situation, ratings=make["ratings"]().iloc[:1]))
    birch = frame[frame["source"] == "incident:B"]
    assert len(birch) and birch["priority_high"].max() == pytest.approx(1.0)
    assert "not rated" in next(fire["reason"] for fire in fires if fire["incident_id"] == "B")


def test_perimeter_puts_targets_on_its_edge(situation):
    incidents = situation.incidents.copy()
    incidents.loc[0, "geometry"] = box(-108.4, 33.1, -108.0, 33.4)
    frame, _ = _active(replace(situation, incidents=incidents))
    alder = frame[frame["source"] == "incident:A"].sort_values("worth")
    edge = incidents.geometry[0].boundary
    points = geopandas.points_from_xy(alder["longitude_deg"], alder["latitude_deg"])
    distance = np.array([edge.distance(point) for point in points])
    assert distance[-10:].max() < 0.04 and distance[:5].min() > 0.035


def test_soil_moisture_and_scars_reach_the_prefire_rewards(make, situation, grid):
    changed = grid.copy(deep=True)
    changed["wfsp_x"] = changed["wfsp_x"] * 0.5
    a, b = (targets.build(situation, g, ACTIVE, PREFIRE)[0] for g in (grid, changed))
    prefire = [f.loc[f["kind"] == "prefire", "priority"].mean() for f in (a, b)]
    assert prefire[1] < prefire[0]


def test_no_fire_gives_prefire_targets_only(situation, grid):
    empty = replace(situation, incidents=situation.incidents.iloc[:0], ratings=situation.ratings.iloc[:0])
    frame, report = targets.build(empty, grid, ACTIVE, PREFIRE)
    assert set(frame["kind"]) == {"prefire"} and report["active_targets"] == 0
    tables.TARGETS.check(frame)


def test_bad_areas_and_maps_are_named(make, situation, grid, time):
    with pytest.raises(DomainError) as caught:
        targets.build(replace(situation, area=(10.0, 0.0, 5.0, 1.0)), grid, ACTIVE, PREFIRE)
    assert caught.value.field == "area"
    broken = make["arrival"]()
    broken["crs"].attrs["crs_wkt"] = "nonsense"
    with pytest.raises(DomainError) as caught:
        expected_front.front_of_map(broken, time, 24)
    assert caught.value.field == "fire_arrival"
    with pytest.raises(DomainError) as caught:
        observation_age.check_observed(pd.DataFrame({"longitude_deg": [np.nan], "latitude_deg": [1.0], "time": [time]}))
    assert caught.value.field == "observed"
