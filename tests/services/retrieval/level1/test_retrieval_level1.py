"""Level-1 files in and out, screening, reflectivity: what real files look like and how they go wrong."""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest

from services.retrieval.constants import WAVELENGTH_M
from services.retrieval.level1.land_screening import LandLimits, screen_land
from services.retrieval.level1.reader import is_simulated, read_level1
from services.retrieval.level1.reflectivity import footprint_m, reflectivity_db
from services.retrieval.looks.features import read_observations
from services.retrieval.simulation.observations import Simulated, simulate_nominal, simulate_raw_if
from shared.errors import DomainError
from tests.services.retrieval import small_world


@pytest.fixture(scope="module")
def simulated() -> Simulated:
    start = small_world.SPLIT_MS
    return simulate_nominal(small_world.points(start, start + 86_400_000), small_world.surface(), 11)


@pytest.fixture
def nominal(simulated: Simulated, tmp_path: Path) -> Path:
    path = tmp_path / "nominal.nc"
    simulated.write(path, {"code_version": "test"})
    return path


def test_reflectivity_inverts_the_coherent_link_budget() -> None:
    """A perfect mirror (reflectivity 1) returns EIRP G (lambda / (4 pi (Rt + Rr)))^2."""
    power = 500.0 * 10.0 * (WAVELENGTH_M / (4 * np.pi * 21.6e6)) ** 2
    values = (np.array([power]), np.array([500.0]), np.array([10.0]), np.array([6e5]), np.array([21e6]))
    assert reflectivity_db(*values) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(reflectivity_db(np.array([-power]), *values[1:]))


def test_footprint_is_the_first_fresnel_zone_drawn_out_by_motion() -> None:
    along, across = footprint_m(np.array([0.0]), np.array([6e5]), np.array([20.4e6]), 0.5)
    assert across == pytest.approx(666.0, abs=3.0)
    assert along - across == pytest.approx(3300.0)


def test_file_has_the_real_names_dimensions_and_fills(nominal: Path) -> None:
    with netCDF4.Dataset(nominal) as file:
        file.set_auto_mask(False)
        assert file["power_analog"].dimensions == ("sample", "ddm", "delay", "doppler")
        assert file["power_analog"].shape[1:] == (4, 17, 11)
        longitude = file["sp_lon"][:]
        filled = longitude != -9999.0
        assert longitude[filled].min() > 180.0  # 0-360, this world lies west
        assert np.all(file["quality_flags"][:][filled] & 1 == 1)  # poor_overall_quality is set on all land
        assert np.all(file["power_analog"][:][~filled] == -9999.0)
        assert float(file["delay_resolution"][...]) == pytest.approx(0.2552, abs=1e-4)
        assert file.processing_level == "1"


def test_radar_cross_section_gives_the_reflectivity(nominal: Path) -> None:
    """brcs = (4 pi)^3 P Rt^2 Rr^2 / (EIRP G lambda^2), so Gamma = brcs (Rt + Rr)^2 / (4 pi Rt^2 Rr^2)."""
    chunk = next(read_level1(nominal, further_maps=("brcs",)))
    meta, usable = chunk.metadata, chunk.power_w.max(axis=(1, 2)) > 0
    section = np.nanmax(chunk.further["brcs"][usable], axis=(1, 2)).astype(np.float64)
    rx_m, tx_m = (meta.loc[usable, name].to_numpy() for name in ("rx_to_sp_range", "tx_to_sp_range"))
    columns = (meta.loc[usable, name].to_numpy() for name in ("gps_eirp", "sp_rx_gain"))
    peak = chunk.power_w[usable].max(axis=(1, 2)).astype(np.float64)
    expected = reflectivity_db(peak, *columns, rx_m, tx_m)
    found = 10 * np.log10(section * ((rx_m + tx_m) / (rx_m * tx_m)) ** 2 / (4 * np.pi))
    assert usable.sum() > 100 and np.abs(found - expected).max() < 0.01
    assert meta.loc[usable, "coherency_ratio"].between(0.1, 1000.0).all()
    assert is_simulated(nominal)


def test_reading_in_small_chunks_gives_what_was_written(nominal: Path, simulated: Simulated) -> None:
    chunks = list(read_level1(nominal, chunk_samples=7))
    assert len(chunks) > 3
    power = np.concatenate([c.power_w for c in chunks])
    meta = pd.concat([c.metadata for c in chunks], ignore_index=True)
    kept = ~meta["all_fill"].to_numpy()
    order = np.argsort(simulated.looks["sample"].to_numpy() * 4 + simulated.looks["ddm"].to_numpy())
    written = simulated.maps[order]
    assert kept.sum() == len(written)
    assert np.allclose(power[kept], written, rtol=6e-4, atol=1e-24)
    times = simulated.looks["time_ms"].to_numpy()[order].astype("datetime64[ms]")
    assert np.array_equal(meta["time"].to_numpy()[kept].astype("datetime64[ms]"), times)


def test_the_same_looks_give_the_same_bytes(simulated: Simulated, tmp_path: Path) -> None:
    for name in ("a.nc", "b.nc"):
        simulated.write(tmp_path / name, {})
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_retrieved_reflectivity_is_the_simulated_coherent_one(nominal: Path, simulated: Simulated) -> None:
    """Strong looks: within the look-to-look spread, EIRP error and straddling loss of the simulation."""
    looks = read_observations([nominal]).looks
    keys = ["time", "satellite", "prn"]
    truth = simulated.looks.assign(
        time=simulated.looks["time_ms"].to_numpy().astype("datetime64[ms]"), satellite=simulated.looks["spacecraft"]
    )
    both = looks.merge(truth[[*keys, "coherent_db"]], on=keys)
    strong = both[both["snr_db"] > 8]
    error = strong["reflectivity_db"] - strong["coherent_db"]
    assert len(strong) >= 40
    assert abs(error.mean()) < 1.0
    assert error.std() < 1.6


def test_real_daily_files_have_a_scalar_spacecraft_and_fractional_start(nominal: Path) -> None:
    with netCDF4.Dataset(nominal, "a") as file:
        file.renameVariable("spacecraft_num", "spacecraft_num_each")
        scalar = file.createVariable("spacecraft_num", "i2")
        scalar[...] = 4
        file["ddm_timestamp_utc"].units = "seconds since 2023-08-28 00:00:00.999261529"
    chunk = next(read_level1(nominal))
    assert set(chunk.metadata["satellite"]) == {4}
    assert chunk.metadata["time"].min() >= np.datetime64("2023-08-28T00:00:00.999")


def _screened(nominal: Path, **change: object) -> tuple[np.ndarray, dict[str, int]]:
    chunk = next(read_level1(nominal))
    meta = chunk.metadata.copy()
    for name, value in change.items():
        meta.loc[~meta["all_fill"], name] = value
    peak = chunk.power_w.reshape(len(meta), -1).max(axis=1)
    return screen_land(meta, peak, LandLimits(min_snr_db=-99))


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("s_band_powered_up", {"quality_flags": 7169 | 1 << 1}),
        ("sp_non_existent_error", {"quality_flags": 7169 | 1 << 22}),
        ("land_poor_overall_quality", {"quality_flags_2": 2048}),
        ("incidence_too_high", {"sp_inc_angle": 70.0}),
        ("rx_gain_too_low", {"sp_rx_gain": -1.0}),
        ("unknown_prn", {"prn_code": 77}),
        ("not_land", {"sp_land_valid": 0}),
        ("open_water", {"pekel_sp_water_percentage_5km": 60.0}),
        ("missing_metadata", {"sp_lat": np.nan}),
        ("missing_metadata", {"gps_eirp": -3.0}),
    ],
)
def test_each_reason_screens_every_look_and_is_counted(nominal: Path, reason: str, change: dict[str, object]) -> None:
    usable, counts = _screened(nominal, **change)
    assert not usable.any()
    assert counts[reason] == len(usable) - counts["all_fill"]


def test_bit_zero_screens_nothing(nominal: Path) -> None:
    with_bit, _ = _screened(nominal, quality_flags=1)
    without, _ = _screened(nominal, quality_flags=0)
    assert with_bit.any() and np.array_equal(with_bit, without)


def test_maps_of_fill_of_part_fill_and_of_negative_power_are_flagged(nominal: Path) -> None:
    with netCDF4.Dataset(nominal, "a") as file:
        file.set_auto_mask(False)
        power = file["power_analog"][:]
        first = np.argwhere(power[:, :, 0, 0] != -9999.0)
        power[tuple(first[0])] = -9999.0
        power[tuple(first[1])][3, 3] = -9999.0
        power[tuple(first[2])] = -1e-18
        file["power_analog"][:] = power
    before = _counts_without_damage(nominal, power)
    counts = read_observations([nominal]).screening["nominal"]
    assert counts["all_fill"] == before + 1
    assert counts["part_fill"] == 1
    assert counts["peak_not_positive"] == 1
    assert counts["read"] == power.shape[0] * 4


def _counts_without_damage(nominal: Path, power: np.ndarray) -> int:
    with netCDF4.Dataset(nominal) as file:
        file.set_auto_mask(False)
        return int((file["sp_lat"][:] == -9999.0).sum())


def test_truncated_file_is_named(nominal: Path) -> None:
    content = nominal.read_bytes()
    nominal.write_bytes(content[: len(content) // 2])
    with pytest.raises(DomainError, match=r"nominal\.nc") as error:
        list(read_level1(nominal))
    assert error.value.field == "observations"


def test_swapped_delay_and_doppler_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "swapped.nc"
    with netCDF4.Dataset(path, "w") as file:
        for name, size in (("sample", 2), ("ddm", 4), ("delay", 11), ("doppler", 17)):
            file.createDimension(name, size)
        for name in ("sp_lat", "sp_lon", "sp_inc_angle", "sp_rx_gain", "gps_eirp", "prn_code", "quality_flags"):
            file.createVariable(name, "f4", ("sample", "ddm"))
        for name in ("rx_to_sp_range", "tx_to_sp_range"):
            file.createVariable(name, "i4", ("sample", "ddm"))
        file.createVariable("ddm_timestamp_utc", "f8", ("sample",))
        file.createVariable("power_analog", "f4", ("sample", "ddm", "delay", "doppler"))
    with pytest.raises(DomainError, match="swapped"):
        list(read_level1(path))


def test_missing_variable_is_named(nominal: Path) -> None:
    with netCDF4.Dataset(nominal, "a") as file:
        file.renameVariable("gps_eirp", "eirp")
    with pytest.raises(DomainError) as error:
        list(read_level1(nominal))
    assert error.value.field == "gps_eirp"


def test_times_cut_the_looks(nominal: Path) -> None:
    every = read_observations([nominal]).looks
    middle = every["time"].sort_values().iloc[len(every) // 2].to_datetime64()
    early = read_observations([nominal], time_to=middle)
    late = read_observations([nominal], time_from=middle).looks
    assert len(early.looks) + len(late) == len(every)
    assert early.looks["time"].max() < middle <= late["time"].min()
    assert early.screening["nominal"]["outside_time"] == len(late)


def test_raw_if_files_read_with_their_own_shape(tmp_path: Path) -> None:
    start = small_world.SPLIT_MS
    points = small_world.points(start, start + 86_400_000)
    made = simulate_raw_if(points, small_world.images_of(points, 30), small_world.surface(), 5)
    made.write(tmp_path / "raw.nc", {})
    chunk = next(read_level1(tmp_path / "raw.nc"))
    assert chunk.mode == "raw-if" and chunk.power_w.shape[1:] == (69, 111)
    assert chunk.doppler_resolution_hz == 50.0
