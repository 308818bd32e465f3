"""Delivery: nothing that was measured counts before it has come down."""

from __future__ import annotations

import geopandas
import pandas as pd

from flows.steps.delivery import sort_points

START = pd.Timestamp("2025-09-01T00:00:00Z")
END = START + pd.Timedelta(hours=24)


def at(hours: float) -> pd.Timestamp:
    return START + pd.Timedelta(hours=hours)


def points(*hours: float, nominal: bool = True) -> geopandas.GeoDataFrame:
    times = pd.Series([at(h) for h in hours]).astype("datetime64[ms, UTC]")
    frame = {"satellite": "CYGFM01", "transmitter": "G07", "time": times, "nominal": nominal}
    return geopandas.GeoDataFrame(frame, geometry=geopandas.points_from_xy([0.0] * len(hours), [0.0] * len(hours)))


CONTACTS = pd.DataFrame(
    {
        "satellite": "CYGFM01",
        "start": pd.Series([at(6), at(23), at(30)]).astype("datetime64[ms, UTC]"),
        "end": pd.Series([at(6.1), at(23.1), at(30.1)]).astype("datetime64[ms, UTC]"),
    }
)


def images(status: str, *hours: float) -> pd.DataFrame:
    times = pd.Series([at(h) for h in hours], dtype="datetime64[ms, UTC]")
    return pd.DataFrame({"satellite": "CYGFM01", "start": times, "status": status})


def test_nominal_data_wait_for_the_next_contact_and_for_processing() -> None:
    sorted_points = sort_points(points(1, 6.05, 23.5), images("collected"), CONTACTS, END, 2 * 3600)
    assert sorted_points.nominal["time"].tolist() == [at(1)], "the pass at 23 h is level 1 only at 25.1 h"
    assert sorted_points.pending["time"].tolist() == [at(6.05), at(23.5)]


def test_an_image_holds_only_what_was_in_the_beams() -> None:
    seen = points(1, 1).assign(transmitter=["G07", "G08"], in_beam=[True, False])
    sorted_points = sort_points(seen, images("downlinked", 1), CONTACTS, END, 2 * 3600)
    assert sorted_points.raw_if["transmitter"].tolist() == ["G07"]
    assert sorted_points.nominal["transmitter"].tolist() == ["G07", "G08"]


def test_pending_points_are_delivered_once_in_the_next_cycle() -> None:
    first = sort_points(points(1, 6.05), images("collected"), CONTACTS, END, 2 * 3600)
    second = sort_points(first.pending, images("collected"), CONTACTS, END + pd.Timedelta(hours=24), 2 * 3600)
    assert second.nominal["time"].tolist() == [at(6.05)]
    assert second.pending.empty


def test_data_that_are_down_but_in_processing_need_no_further_pass() -> None:
    """The pass at 23 h brought them down; the next cycle knows only its own passes, of which there are none."""
    first = sort_points(points(20), images("collected"), CONTACTS, END, 2 * 3600)
    assert first.nominal.empty
    second = sort_points(first.pending, images("collected"), CONTACTS.iloc[:0], END + pd.Timedelta(hours=6), 2 * 3600)
    assert second.nominal["time"].tolist() == [at(20)]


def test_raw_if_points_come_with_their_image_and_not_before() -> None:
    recorded = points(1, 2, 3)
    run = pd.concat([images("downlinked", 1), images("collected", 2), images("lost", 3)], ignore_index=True)
    first = sort_points(recorded, run, CONTACTS, END, 0)
    assert first.raw_if["time"].tolist() == [at(1)]
    assert first.pending["time"].tolist() == [at(2)]
    assert not first.pending["nominal_due"].any(), "its nominal data are down already"
    second = sort_points(first.pending, images("downlinked", 2), CONTACTS, END + pd.Timedelta(hours=24), 0)
    assert second.raw_if["time"].tolist() == [at(2)]
    assert second.nominal.empty


def test_points_outside_the_four_nominal_channels_have_no_nominal_data() -> None:
    sorted_points = sort_points(points(1, nominal=False), images("downlinked", 1), CONTACTS, END, 0)
    assert sorted_points.nominal.empty
    assert len(sorted_points.raw_if) == 1
