"""Bad input through the processes: named errors, or samples flagged and counted; nothing half-written."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest
import rasterio
from PIL import Image

from services.retrieval.level1.reader import read_level1
from services.retrieval.looks.observation_report import NOMINAL_BYTES_S, RAW_IF_BYTES_S
from services.retrieval.raw_if.recording import HEADER, Header, write_recording
from services.retrieval.simulation.observations import simulate_nominal
from shared.contracts import tables
from shared.contracts.schema import read_attributes, read_table
from shared.errors import DomainError
from tests.services.retrieval import small_world
from tests.services.retrieval.raw_if.test_retrieval_raw_if import HEAD, _samples
from tests.services.retrieval.running import local as _local
from tests.services.retrieval.running import run as _run


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A sound level-1 file of half a day."""
    start = small_world.SPLIT_MS
    path = tmp_path_factory.mktemp("sound") / "nominal.nc"
    simulate_nominal(small_world.points(start, start + 43_200_000), small_world.surface(), 3).write(path, {})
    return path.read_bytes()


@pytest.fixture
def root(tmp_path: Path, content: bytes) -> Path:
    (tmp_path / "in").mkdir()
    (tmp_path / "in/nominal.nc").write_bytes(content)
    return tmp_path


def _change(root: Path, change: Callable[[netCDF4.Dataset], None]) -> None:
    with netCDF4.Dataset(root / "in/nominal.nc", "a") as file:
        file.set_auto_maskandscale(False)
        change(file)


def _retrieve(root: Path) -> tuple[dict[str, Any], dict[str, int]]:
    made = _run(root, "retrieve-burned-area", observations=[{"href": "in/nominal.nc"}])
    return made, json.loads(_local(made["report"]).read_text())["screening"]["nominal"]


def _set(file: netCDF4.Dataset, name: str, value: float, samples: int = 5) -> int:
    """Put a value into the looks of the first samples; how many looks that are."""
    filled = file["sp_lat"][:samples] != -9999.0
    values = file[name][:samples]
    values[filled] = value
    file[name][:samples] = values
    return int(filled.sum())


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.95])
def test_truncated_netcdf_is_a_named_error_and_leaves_nothing(root: Path, content: bytes, share: float) -> None:
    (root / "in/nominal.nc").write_bytes(content[: int(share * len(content))])
    with pytest.raises(DomainError, match="nominal") as error:
        _retrieve(root)
    assert error.value.field == "observations"
    assert not list(root.rglob("manifest.json"))


@pytest.mark.parametrize("process", ["retrieve-burned-area", "train-burned-area"])
def test_swapped_axes_are_a_named_error(root: Path, process: str) -> None:
    def swap(file: netCDF4.Dataset) -> None:
        file.renameVariable("power_analog", "kept")
        file.createDimension("delay_", 11)
        file.createDimension("doppler_", 17)
        file.renameDimension("delay", "delay_kept")
        file.renameDimension("doppler", "doppler_kept")
        file.renameDimension("delay_", "delay")
        file.renameDimension("doppler_", "doppler")
        file.createVariable("power_analog", "f4", ("sample", "ddm", "delay", "doppler"))

    _change(root, swap)
    given = {"labels": {"href": "in/nominal.nc"}} if process.startswith("train") else {}
    with pytest.raises(DomainError, match="swapped") as error:
        _run(root, process, observations=[{"href": "in/nominal.nc"}], **given)
    assert error.value.field == "power_analog"


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("power_analog", -9999.0, "all_fill"),
        ("power_analog", np.nan, "all_fill"),
        ("power_analog", 9.96921e36, "all_fill"),
        ("power_analog", -3e-18, "peak_not_positive"),
        ("power_analog", 0.0, "peak_not_positive"),
        ("prn_code", 77, "unknown_prn"),
        ("prn_code", 0, "unknown_prn"),
        ("prn_code", -99999999, "unknown_prn"),
        ("gps_eirp", -9999.0, "missing_metadata"),
        ("sp_lat", -9999.0, "missing_metadata"),
        ("quality_flags", -99999999, "missing_metadata"),
        ("sp_rx_gain", -3.0, "rx_gain_too_low"),
        ("ddm_snr", -4.0, "snr_too_low"),
    ],
)
def test_bad_samples_are_flagged_and_counted(root: Path, name: str, value: float, reason: str) -> None:
    sound, before = _retrieve(root)
    hit = []
    _change(root, lambda file: hit.append(_set(file, name, value)))
    made, after = _retrieve(root)
    assert 0 < made["look_count"] < sound["look_count"]
    assert after["read"] == before["read"]
    assert after.get(reason, 0) - before.get(reason, 0) > 0
    assert after[reason] - before.get(reason, 0) <= hit[0]
    assert made["look_count"] == after["usable"]


def test_a_file_of_nothing_but_fill_is_an_empty_product(root: Path) -> None:
    def wipe(file: netCDF4.Dataset) -> None:
        file["power_analog"][:] = -9999.0

    _change(root, wipe)
    made, counts = _retrieve(root)
    assert made["look_count"] == 0 and counts["all_fill"] == counts["read"] and counts["usable"] == 0
    assert len(read_table(_local(made["burned_area"]), tables.BURNED_AREA)) == 0


def _instead(name: str, dimensions: tuple[str, ...], kind: Any = "f4") -> Callable[[netCDF4.Dataset], None]:
    def change(file: netCDF4.Dataset) -> None:
        file.renameVariable(name, "kept")
        file.createVariable(name, kind, dimensions)

    return change


def _units(text: str) -> Callable[[netCDF4.Dataset], None]:
    return lambda file: file["ddm_timestamp_utc"].setncattr("units", text)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (_instead("sp_lat", ("sample",)), "sp_lat"),
        (_instead("sp_lat", ("ddm", "sample")), "sp_lat"),
        (_instead("prn_code", ("sample", "ddm"), str), "prn_code"),
        (_instead("ddm_timestamp_utc", ("sample", "ddm"), "f8"), "ddm_timestamp_utc"),
        (_instead("power_analog", ("sample", "ddm", "doppler", "delay")), "power_analog"),
        (_instead("power_analog", ("sample", "delay", "doppler")), "power_analog"),
        (_units("seconds since yesterday"), "ddm_timestamp_utc"),
        (_units("days since 2024-03-01"), "ddm_timestamp_utc"),
    ],
)
def test_a_variable_of_another_shape_is_named(
    root: Path, change: Callable[[netCDF4.Dataset], None], field: str
) -> None:
    _change(root, change)
    with pytest.raises(DomainError) as error:
        _retrieve(root)
    assert error.value.field == field and error.value.accepted
    assert str(root) not in str(error.value)


@pytest.mark.parametrize("units", ["seconds since 2024-03-01 00:00:00.999261529", "seconds since 2024-03-01T00:00:01Z"])
def test_times_are_read_however_the_epoch_is_written(root: Path, units: str) -> None:
    _change(root, _units(units))
    with netCDF4.Dataset(root / "in/nominal.nc") as file:
        first = float(file["ddm_timestamp_utc"][0])
    found = next(read_level1(root / "in/nominal.nc")).metadata["time"][0]
    expected = np.datetime64("2024-03-01T00:00:01", "ms") + np.timedelta64(round(1e3 * first), "ms")
    assert abs(found.to_datetime64() - expected) <= np.timedelta64(1, "ms")


def test_places_beyond_the_grid_are_left_out_and_counted(root: Path) -> None:
    _, before = _retrieve(root)
    hit = []
    _change(root, lambda file: hit.append(_set(file, "sp_lat", 89.9)))
    made, after = _retrieve(root)
    assert 0 < after["outside_grid"] <= hit[0]
    assert made["look_count"] == after["usable"] - after["outside_grid"]
    assert after["usable"] == before["usable"]


def test_times_of_fill_are_flagged(root: Path) -> None:
    def wipe(file: netCDF4.Dataset) -> None:
        file["ddm_timestamp_utc"][:4] = -9999.0

    _change(root, wipe)
    assert _retrieve(root)[1]["no_time"] > 0


def test_every_product_says_what_was_screened(root: Path) -> None:
    made, counts = _retrieve(root)
    assert json.loads(read_attributes(_local(made["burned_area"]))["screening"])["nominal"] == counts
    with netCDF4.Dataset(_local(made["grid"])) as grid:
        assert json.loads(grid.screening)["nominal"] == counts
    assert json.loads(json.loads(_local(made["geojson"]).read_text())["product"]["screening"])["nominal"] == counts
    assert json.loads(Image.open(_local(made["map"])).info["screening"])["nominal"] == counts
    with rasterio.open(_local(made["cog"])) as cog:
        assert json.loads(cog.tags()["screening"])["nominal"] == counts


def test_brcs_and_counts_are_read_beside_power(root: Path) -> None:
    with netCDF4.Dataset(root / "in/nominal.nc") as file:
        file.set_auto_mask(False)
        counts = file["raw_counts"][:].reshape(-1, 17, 11)
    chunks = list(read_level1(root / "in/nominal.nc", 7, further_maps=("raw_counts",)))
    found = np.concatenate([chunk.further["raw_counts"] for chunk in chunks])
    fill = counts == -99999999
    assert np.isnan(found[fill]).all() and np.array_equal(found[~fill], counts[~fill].astype(np.float32))
    with pytest.raises(DomainError) as error:
        list(read_level1(root / "in/nominal.nc", further_maps=("eff_scatter",)))
    assert error.value.field == "eff_scatter"


def test_a_day_is_read_in_chunks_not_whole(tmp_path: Path) -> None:
    """A long file, of which no more than a chunk may be held: traced memory stays below a quarter of the maps."""
    import tracemalloc

    path, samples = tmp_path / "day.nc", 20_000
    with netCDF4.Dataset(path, "w") as file:
        for name, size in (("sample", samples), ("ddm", 4), ("delay", 17), ("doppler", 11)):
            file.createDimension(name, size)
        for name in ("sp_lat", "sp_lon", "sp_inc_angle", "sp_rx_gain", "gps_eirp", "prn_code", "quality_flags"):
            file.createVariable(name, "f4", ("sample", "ddm"), zlib=True)[:] = 1.0
        for name in ("rx_to_sp_range", "tx_to_sp_range"):
            file.createVariable(name, "i4", ("sample", "ddm"), zlib=True)[:] = 1
        time = file.createVariable("ddm_timestamp_utc", "f8", ("sample",))
        time.units = "seconds since 2024-01-01 00:00:00.5"
        time[:] = 0.5 * np.arange(samples)
        sizes = (500, 4, 17, 11)
        maps = file.createVariable(
            "power_analog", "f4", ("sample", "ddm", "delay", "doppler"), zlib=True, chunksizes=sizes
        )
        for start in range(0, samples, 500):
            maps[start : start + 500] = 1e-18
    tracemalloc.start()
    seen = sum(len(chunk.metadata) for chunk in read_level1(path, 500))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seen == samples * 4
    assert peak < samples * 4 * 17 * 11 * 4 / 4


def _recording(root: Path, change: Callable[[bytearray], None]) -> None:
    write_recording(root / "in/raw.bin", HEAD, _samples(12, 0.12, 400.25, 1730.0))
    content = bytearray((root / "in/raw.bin").read_bytes())
    change(content)
    (root / "in/raw.bin").write_bytes(content)


def _map(root: Path, **given: Any) -> dict[str, Any]:
    asked = {"prn": 7, "doppler_hz": 1700.0, "search_hz": 250.0, "milliseconds": 10, **given}
    return _run(root, "compute-ddm", recording={"href": "in/raw.bin"}, **asked)


@pytest.mark.parametrize(
    ("offset", "value", "field"), [(0, b"DRT1", "recording.magic"), (10, b"\x09", "recording.header")]
)
def test_a_bad_header_is_a_named_error(root: Path, offset: int, value: bytes, field: str) -> None:
    def spoil(content: bytearray) -> None:
        content[offset : offset + len(value)] = value

    _recording(root, spoil)
    with pytest.raises(DomainError) as error:
        _map(root)
    assert error.value.field == field and error.value.accepted


def test_a_recording_cut_within_the_header_is_a_named_error(root: Path) -> None:
    (root / "in/raw.bin").write_bytes(b"DRT0" + bytes(20))
    with pytest.raises(DomainError) as error:
        _map(root)
    assert error.value.field == "recording"


def test_lost_packets_are_left_out_counted_and_do_not_move_the_peak(root: Path) -> None:
    _recording(root, lambda content: None)
    sound = json.loads(_local(_map(root)["report"]).read_text())

    def lose(content: bytearray) -> None:
        for ms in (2, 6, 7):
            start = HEADER.size + 3 * 4009 * ms + 900
            content[start : start + 2048] = bytes(2048)

    _recording(root, lose)
    report = json.loads(_local(_map(root)["report"]).read_text())
    with netCDF4.Dataset(_local(_map(root)["ddm"])) as file:
        assert json.loads(file.screening)["raw-if"] == {"lost_packets_ms": 3, "read_ms": 10, "usable_ms": 7}
    assert (sound["milliseconds_used"], sound["milliseconds_lost"]) == (10, 0)
    assert (report["milliseconds_used"], report["milliseconds_lost"]) == (7, 3)
    assert report["code_phase_chips"] == pytest.approx(sound["code_phase_chips"], abs=0.07)
    assert report["doppler_hz"] == sound["doppler_hz"]


def test_a_recording_of_lost_packets_only_is_a_named_error(root: Path) -> None:
    def lose(content: bytearray) -> None:
        content[HEADER.size :] = bytes(len(content) - HEADER.size)

    _recording(root, lose)
    with pytest.raises(DomainError, match="lost packets"):
        _map(root)


@pytest.mark.parametrize(("given", "field"), [({"channel": 3}, "channel"), ({"look": {"height": 1.0}}, "look")])
def test_what_the_recording_does_not_have_is_named(root: Path, given: dict[str, Any], field: str) -> None:
    _recording(root, lambda content: None)
    with pytest.raises(DomainError) as error:
        _map(root, **given)
    assert error.value.field == field


def test_volumes_of_both_modes_are_reported(root: Path) -> None:
    """A raw-IF second is three channels of two-bit samples at 16.0362 MHz, 1,680 times a nominal one."""
    assert pytest.approx(12_027_150) == RAW_IF_BYTES_S
    assert pytest.approx(1680) == RAW_IF_BYTES_S / NOMINAL_BYTES_S
    _recording(root, lambda content: None)
    report = json.loads(_local(_map(root)["report"]).read_text())["data_volume"]
    assert report["raw_if_bytes"] == (root / "in/raw.bin").stat().st_size
    assert report["raw_if_to_nominal"] == 1680 and report["ddm_bytes"] > 0
    made, _ = _retrieve(root)
    volume = json.loads(_local(made["report"]).read_text())
    assert volume["data_volume"]["nominal_bytes"] == round(volume["nominal_seconds"] * NOMINAL_BYTES_S)


def test_the_header_is_that_of_the_handbook() -> None:
    assert HEADER.size == 35 and isinstance(HEAD, Header)
