"""Every table contract: what fits comes back unchanged, and what does not is refused by column and row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import shapely

from shared.contracts import tables
from shared.contracts.schema import Column, TableWriter, read_attributes, read_table, write_table
from shared.errors import ContractError

T = [pd.Timestamp("2024-07-01T00:00:00.123Z") + pd.Timedelta(minutes=k) for k in range(3)]
P = list(shapely.points([-107.5, 179.9, 0.0], [33.2, -89.5, 90.0]))
AREA = [point.buffer(0.05) for point in shapely.points([-107.5, 12.0, 0.0], [33.2, -12.0, 60.0])]
SATELLITES = ["CYGFM01", "CYGFM05", "CYGFM05"]

# Three rows of each table, in the order of the columns in the design; a None stands where the contract lets one stand.
ROWS: dict[str, dict[str, list[Any]]] = {
    "STATIONS": {
        "station": ["hawaii", "santiago", "dongara"],
        "latitude_deg": [19.0, -33.1, -29.0],
        "longitude_deg": [-155.6, -70.6, 115.3],
        "height_m": [300.0, 700.0, 250.0],
        "mask_deg": [5.0, 0.0, 90.0],
        "datum": ["geodetic", "spherical", "geodetic"],
        "up": ["geodetic", "spherical", None],
        "azimuth_mask": ["0:7 90:12.5 180:7", None, None],
    },
    "INCIDENTS": {
        "incident_id": ["a", "b", "c"],
        "name": ["Black", "Größe", "C"],
        "start": T,
        "geometry": [AREA[0], P[1], AREA[2]],
        "area_km2": [12.5, None, 0.0],
        "known_at": T,
    },
    "WEATHER": {
        "time": T,
        "geometry": P,
        "temperature_c": [35.5, None, -10.0],
        "relative_humidity_pct": [5.0, None, 100.0],
        "wind_speed_m_s": [0.0, None, 12.0],
        "wind_direction_deg": [0.0, None, 360.0],
        "rain_mm": [0.0, None, 7.0],
        "valid_at": T,
        "issued_at": T,
    },
    "RATINGS": {
        "incident_id": ["a", "a", "b"],
        "time": T,
        "probability": [0.0, 0.5, 1.0],
        "probability_low": [0.0, 0.4, 0.9],
        "probability_high": [0.1, 0.6, 1.0],
        "percentile": [0.0, 50.0, 100.0],
        "drivers": ["bui", "isi", ""],
        "out_of_domain": [True, False, False],
        "imputed": ["", "wind", ""],
    },
    "TARGETS": {
        "target_id": [1, 2**60, -3],
        "kind": ["active", "prefire", "active"],
        "priority": [1.0, 0.0, 0.5],
        "priority_low": [0.5, 0.0, 0.5],
        "priority_high": [1.0, 0.5, 0.5],
        "source": ["incident", "danger", "detection"],
        "geometry": P,
    },
    "SPECULAR_POINTS": {
        "satellite": SATELLITES,
        "transmitter": ["G07", "E12", "G32"],
        "time": T,
        "geometry": P,
        "incidence_deg": [0.0, 40.0, 90.0],
        "rx_gain_dbi": [-3.0, 10.0, 14.0],
        "rx_range_m": [5e5, 6e5, 7e5],
        "tx_range_m": [2.1e7, 2.2e7, 2.3e7],
    },
    "OPPORTUNITIES": {
        "image_id": [0, 7, 7],
        "satellite": SATELLITES,
        "time": T,
        "target_id": [1, 1, 2],
        "transmitter": ["G07", "E12", "G32"],
        "incidence_deg": [1.0, 2.0, 3.0],
        "distance_km": [0.0, 5.0, 10.0],
        "rx_gain_dbi": [-3.0, 10.0, 14.0],
        "covered_ahead": [True, False, None],
        "covered_behind": [False, None, True],
        "along_track_error_km": [4.2, 0.0, None],
        "pointing": ["nadir", None, "roll+5"],
    },
    "CONTACTS": {
        "satellite": SATELLITES,
        "station": ["hawaii", "santiago", "dongara"],
        "start": T,
        "end": T,
        "max_elevation_deg": [5.0, 45.0, 90.0],
    },
    "ECLIPSES": {"satellite": SATELLITES, "start": T, "end": T, "kind": ["umbra", "penumbra", "umbra"]},
    "SCHEDULE": {
        "satellite": SATELLITES,
        "start": T,
        "end": T,
        "command": ["collect", "downlink", "collect"],
        "image_id": [4, None, 5],
        "station": [None, "hawaii", None],
        "cycle": [0, 0, 1],
        "uplink_contact": [None, T[0], T[1]],
        "pointing": ["roll+5", None, "nadir"],
    },
    "AS_RUN": {
        "satellite": SATELLITES,
        "start": T,
        "end": T,
        "image_id": [4, 5, 6],
        "status": ["collected", "downlinked", "lost"],
        "downlinked_at": [None, T[2], None],
        "station": [None, "hawaii", None],
    },
    "DETECTIONS": {
        "time": T,
        "delivered_at": T,
        "geometry": P,
        "satellite": ["NPP", "N20", "Terra"],
        "instrument": ["VIIRS", "VIIRS", "MODIS"],
        "confidence": [0.0, None, 100.0],
        "frp_mw": [1.5, None, 0.0],
        "fire": [True, True, False],
        "along_m": [375.0, 400.0, 1000.0],
        "across_m": [375.0, 800.0, 2000.0],
    },
    "BURNED_AREA": {
        "time": T,
        "geometry": P,
        "along_m": [3500.0, 6600.0, 500.0],
        "across_m": [500.0, 500.0, 500.0],
        "burned_probability": [0.0, 0.5, 1.0],
        "burned": [False, False, True],
        "confidence": [0.0, 50.0, 100.0],
        "mode": ["nominal", "raw-if", "nominal"],
    },
    "SOIL_MOISTURE": {
        "time": T,
        "row": [0, 10, 405],
        "column": [0, 10, 963],
        "soil_moisture": [0.02, 0.3, 1.0],
        "soil_moisture_sd": [0.01, 0.05, 0.0],
        "count": [1, 2, 0],
        "mode": ["nominal", "raw-if", "nominal"],
    },
    "PERIMETERS": {"incident_id": ["a", "a", "b"], "time": T, "known_at": T, "geometry": AREA},
}
DTYPES = {
    "int64": "int64",
    "int32": "int32",
    "float64": "float64",
    "string": "object",
    "bool": "bool",
    "time": "datetime64[ms, UTC]",
    "geometry": "geometry",
}
UNIQUE = {name: schema.unique for name, schema in tables.ALL.items() if schema.unique}
COLUMNS = [(name, column) for name, schema in tables.ALL.items() for column in schema.columns]


def label(value: Any) -> str:
    return value.name if isinstance(value, Column) else str(value)


def example(name: str) -> pd.DataFrame:
    rows = ROWS[name]
    if "geometry" in rows:
        return geopandas.GeoDataFrame(rows, geometry="geometry", crs="EPSG:4326")
    return pd.DataFrame(rows)


def with_value(name: str, column: str, row: int, value: Any) -> pd.DataFrame:
    """The example with one cell replaced, and pandas left to choose the type."""
    cells = list(ROWS[name][column])
    cells[row] = value
    return example(name).drop(columns=column).assign(**{column: cells})


def refusal(name: str, frame: pd.DataFrame, column: str, row: int | None = None) -> ContractError:
    """The refusal of a frame, which names the table, the column and the row."""
    with pytest.raises(ContractError) as caught:
        tables.ALL[name].check(frame)
    assert caught.value.field == column
    assert f"'{tables.ALL[name].name}'" in caught.value.message
    assert column in caught.value.message
    if row is not None:
        assert f"row {row}" in caught.value.message
    return caught.value


def plain(values: pd.Series[Any]) -> list[Any]:
    return [None if pd.isna(value) else value for value in values.tolist()]


def test_the_contracts_are_those_of_the_design() -> None:
    assert {name: list(rows) for name, rows in ROWS.items()} == {
        name: [column.name for column in schema.columns] for name, schema in tables.ALL.items()
    }
    assert UNIQUE == {
        "STATIONS": ("station",),
        "INCIDENTS": ("incident_id",),
        "RATINGS": ("incident_id", "time"),
        "TARGETS": ("target_id",),
        "OPPORTUNITIES": ("image_id", "target_id"),
    }


@pytest.mark.parametrize("name", tables.ALL)
def test_a_table_comes_back_as_it_was(name: str, tmp_path: Path) -> None:
    schema, frame = tables.ALL[name], example(name)
    write_table(tmp_path / "a.parquet", frame, schema, {"simulated": True, "process": "test"})
    found = read_table(tmp_path / "a.parquet", schema)
    assert list(found.columns) == list(ROWS[name])
    for column in schema.columns:
        nulls = frame[column.name].isna().any()
        expected = {"int32": "Int32", "bool": "boolean"}.get(column.kind) if nulls else None
        assert str(found[column.name].dtype) == (expected or DTYPES[column.kind]), column.name
        assert plain(found[column.name]) == plain(frame[column.name]), column.name
    assert read_attributes(tmp_path / "a.parquet") == {"table": schema.name, "simulated": True, "process": "test"}


def test_identifiers_have_the_widths_of_the_design() -> None:
    assert str(tables.OPPORTUNITIES.check(example("OPPORTUNITIES"))["image_id"].dtype) == "int32"
    assert str(tables.OPPORTUNITIES.check(example("OPPORTUNITIES"))["target_id"].dtype) == "int64"
    assert str(tables.SCHEDULE.check(example("SCHEDULE"))["cycle"].dtype) == "int32"


@pytest.mark.parametrize("name", tables.ALL)
def test_times_are_stored_in_milliseconds_utc(name: str, tmp_path: Path) -> None:
    write_table(tmp_path / "a.parquet", example(name), tables.ALL[name])
    stored = pq.read_schema(tmp_path / "a.parquet")
    for column in tables.ALL[name].columns:
        if column.kind == "time":
            assert str(stored.field(column.name).type) == "timestamp[ms, tz=UTC]"


@pytest.mark.parametrize("name", tables.ALL)
def test_further_columns_stay_on_their_rows(name: str, tmp_path: Path) -> None:
    frame = example(name).assign(note=["row 0", "row 1", "row 2"], weight=[0.0, 1.0, 2.0])
    shuffled = frame.iloc[[2, 0]]
    write_table(tmp_path / "a.parquet", shuffled, tables.ALL[name])
    found = read_table(tmp_path / "a.parquet", tables.ALL[name])
    assert found["note"].tolist() == ["row 2", "row 0"]
    assert found["weight"].tolist() == [2.0, 0.0]
    for column in ROWS[name]:
        assert plain(found[column]) == [ROWS[name][column][2], ROWS[name][column][0]], column


@pytest.mark.parametrize("name", tables.ALL)
def test_a_table_without_rows_keeps_its_types(name: str, tmp_path: Path) -> None:
    empty = pd.DataFrame({column: [] for column in ROWS[name]}, dtype=object)
    write_table(tmp_path / "a.parquet", empty, tables.ALL[name])
    found = read_table(tmp_path / "a.parquet", tables.ALL[name])
    assert len(found) == 0
    for column in tables.ALL[name].columns:
        assert str(found[column.name].dtype) == DTYPES[column.kind], column.name


@pytest.mark.parametrize(("name", "column"), COLUMNS, ids=label)
def test_a_missing_column_is_named(name: str, column: Column, tmp_path: Path) -> None:
    frame = pd.DataFrame(example(name)).drop(columns=column.name)
    if not column.required:
        assert column.name not in tables.ALL[name].check(frame).columns
        return
    refusal(name, frame, column.name)
    with pytest.raises(ContractError):
        write_table(tmp_path / "a.parquet", frame, tables.ALL[name])
    assert not (tmp_path / "a.parquet").exists()


@pytest.mark.parametrize(("name", "column"), COLUMNS, ids=label)
def test_nulls_stand_only_where_the_contract_says(name: str, column: Column) -> None:
    frame = with_value(name, column.name, 1, None)
    allowed = [row for row in range(3) if ROWS[name][column.name][row] is None]
    if column.nullable:
        assert allowed, "an example of each null that may stand"
        assert tables.ALL[name].check(frame)[column.name].isna().tolist() == [row in {1, *allowed} for row in range(3)]
    else:
        assert "null" in refusal(name, frame, column.name, 1).message


def bad_values() -> list[tuple[str, Column, Any]]:
    found: list[tuple[str, Column, Any]] = []
    for name, column in COLUMNS:
        if column.minimum is not None:
            found.append((name, column, column.minimum - 1))
        if column.maximum is not None:
            found.append((name, column, column.maximum + 1))
        if column.kind == "float64":
            found += [(name, column, np.inf), (name, column, -np.inf)]
        if column.values:
            found.append((name, column, column.values[0].upper()))
        if column.kind == "geometry":
            found += [(name, column, shapely.Point(*at)) for at in ((np.nan, 1), (1, np.nan), (180.1, 0), (0, -90.1))]
            line = shapely.from_wkt("LINESTRING (0 0, 1 NaN, 2 2)")
            found += [(name, column, shapely.Point()), (name, column, line)]
    return found


@pytest.mark.parametrize(("name", "column", "value"), bad_values(), ids=label)
def test_a_value_out_of_range_is_named_with_its_row(name: str, column: Column, value: Any) -> None:
    error = refusal(name, with_value(name, column.name, 2, value), column.name, 2)
    assert error.accepted
    assert "value" in error.details()


def test_the_ranges_are_those_that_the_design_states() -> None:
    for name, column, value in [
        ("TARGETS", "kind", "burning"),
        ("ECLIPSES", "kind", "annular"),
        ("SCHEDULE", "command", "sleep"),
        ("AS_RUN", "status", "planned"),
        ("BURNED_AREA", "mode", "raw"),
        ("DETECTIONS", "confidence", 100.5),
        ("RATINGS", "probability", 1.01),
        ("STATIONS", "datum", "WGS84"),
    ]:
        refusal(name, with_value(name, column, 0, value), column, 0)


def test_the_row_is_counted_in_the_frame_as_given() -> None:
    frame = with_value("TARGETS", "priority", 2, -1.0).iloc[[2, 0]]
    refusal("TARGETS", frame, "priority", 0)


@pytest.mark.parametrize("name", UNIQUE)
def test_a_key_that_stands_twice_is_named(name: str) -> None:
    frame = example(name)
    for column in UNIQUE[name]:
        frame[column] = [ROWS[name][column][k] for k in (0, 1, 0)]
    error = refusal(name, frame, UNIQUE[name][0], 2)
    assert "twice" in error.message


@pytest.mark.filterwarnings("ignore:Could not infer format")
@pytest.mark.parametrize(
    ("name", "column", "value"),
    [
        ("OPPORTUNITIES", "image_id", 2**32 + 5),  # would wrap around to 5
        ("OPPORTUNITIES", "image_id", 1.5),
        ("OPPORTUNITIES", "target_id", 1e30),
        ("SCHEDULE", "image_id", 2**31),  # beside a null
        ("STATIONS", "latitude_deg", "north"),
        ("STATIONS", "station", 7),
        ("DETECTIONS", "fire", "yes"),
        ("DETECTIONS", "fire", 2),
        ("CONTACTS", "start", "yesterday or so"),
        ("TARGETS", "geometry", "POINT (1 2)"),
    ],
)
def test_a_value_of_another_type_is_refused(name: str, column: str, value: Any) -> None:
    refusal(name, pd.DataFrame(with_value(name, column, 0, value)), column)


@pytest.mark.parametrize(
    "values",
    [
        [1_719_792_000] * 3,
        [1.7e9] * 3,
        pd.Series([1_719_792_000] * 3, dtype=object),
        pd.Series([T[0], T[1], 5], dtype=object),
    ],
    ids=["integers", "floats", "objects", "among times"],
)
def test_numbers_are_no_times(values: Any) -> None:
    assert "numbers are not times" in refusal("CONTACTS", example("CONTACTS").assign(start=values), "start").message


def test_times_of_any_resolution_and_zone_are_coerced() -> None:
    at = pd.Timestamp("2024-07-01T12:00:00.123456789")
    for series in (
        pd.Series([at] * 3),  # no zone is UTC
        pd.Series([at.tz_localize("UTC").tz_convert("America/Denver")] * 3),
        pd.Series([at.as_unit("us")] * 3),
        pd.Series(["2024-07-01T14:00:00.123+02:00"] * 3),
    ):
        found = tables.CONTACTS.check(example("CONTACTS").assign(start=series))["start"]
        assert str(found.dtype) == "datetime64[ms, UTC]"
        assert found[0] == pd.Timestamp("2024-07-01T12:00:00.123Z")


def test_a_column_that_stands_twice_is_refused() -> None:
    frame = pd.concat([example("STATIONS"), example("STATIONS")[["station"]]], axis=1)
    refusal("STATIONS", frame, "station")


@pytest.mark.parametrize("name", [name for name, schema in tables.ALL.items() if schema.has_geometry])
def test_others_read_it_as_geoparquet(name: str, tmp_path: Path) -> None:
    write_table(tmp_path / "a.parquet", example(name), tables.ALL[name])
    found = geopandas.read_parquet(tmp_path / "a.parquet")
    assert found.crs.to_authority() == ("OGC", "CRS84")
    assert found.crs.equals("EPSG:4326", ignore_axis_order=True)
    assert found.geometry.tolist() == ROWS[name]["geometry"]
    if name in ("TARGETS", "DETECTIONS"):
        assert found.geometry.x.tolist() == [-107.5, 179.9, 0.0]
    again = tables.ALL[name].check(found)
    assert isinstance(again, geopandas.GeoDataFrame)
    assert again.crs == "EPSG:4326"


def test_positions_of_another_crs_are_brought_to_degrees(tmp_path: Path) -> None:
    metres = example("TARGETS").iloc[:1].to_crs("EPSG:3857")
    metres.to_parquet(tmp_path / "a.parquet")
    read, checked = read_table(tmp_path / "a.parquet", tables.TARGETS), tables.TARGETS.check(metres)
    for found in (read, checked):
        assert found.crs == "EPSG:4326"
        assert found.geometry[0].distance(P[0]) < 1e-9


def test_what_is_no_geoparquet_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    plain_frame = pd.DataFrame(example("TARGETS").drop(columns="geometry"))
    for geometry in ("POINT (1 2)", b"abc", 3.5):
        plain_frame.assign(geometry=geometry).to_parquet(path)
        with pytest.raises(ContractError, match="geometry"):
            read_table(path, tables.TARGETS)
    path.write_bytes(b"no parquet at all")
    with pytest.raises(ContractError, match="Parquet"):
        read_table(path, tables.TARGETS)


@pytest.mark.parametrize("name", tables.ALL)
def test_the_same_frame_gives_the_same_bytes(name: str, tmp_path: Path) -> None:
    attributes = {"simulated": False, "process": "p"}
    write_table(tmp_path / "a.parquet", example(name), tables.ALL[name], attributes)
    write_table(tmp_path / "b.parquet", example(name).copy(), tables.ALL[name], dict(reversed(attributes.items())))
    read = read_table(tmp_path / "a.parquet", tables.ALL[name])
    write_table(tmp_path / "c.parquet", read, tables.ALL[name], attributes)
    first = (tmp_path / "a.parquet").read_bytes()
    assert (tmp_path / "b.parquet").read_bytes() == first
    assert (tmp_path / "c.parquet").read_bytes() == first, "what was read writes back the same"
    write_table(tmp_path / "d.parquet", example(name).iloc[:2], tables.ALL[name], attributes)
    assert (tmp_path / "d.parquet").read_bytes() != first


@pytest.mark.parametrize("name", ["OPPORTUNITIES", "SPECULAR_POINTS"])
def test_a_table_written_in_parts_is_the_table_written_at_once(name: str, tmp_path: Path) -> None:
    schema, frame = tables.ALL[name], example(name)
    with TableWriter(tmp_path / "parts.parquet", schema, frame.iloc[:0], {"simulated": True}) as parts:
        parts.write(frame.iloc[:1])
        parts.write(frame.iloc[1:1])
        parts.write(frame.iloc[1:])
        with pytest.raises(ContractError):
            parts.write(pd.DataFrame(frame).drop(columns=schema.columns[0].name))
    assert parts.rows == len(frame)
    write_table(tmp_path / "once.parquet", frame, schema, {"simulated": True})
    pd.testing.assert_frame_equal(
        pd.DataFrame(read_table(tmp_path / "parts.parquet", schema)),
        pd.DataFrame(read_table(tmp_path / "once.parquet", schema)),
    )
    assert read_attributes(tmp_path / "parts.parquet") == read_attributes(tmp_path / "once.parquet")
    with TableWriter(tmp_path / "none.parquet", schema, frame.iloc[:0]):
        pass
    assert len(read_table(tmp_path / "none.parquet", schema)) == 0
