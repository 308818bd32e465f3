"""The simulator against published numbers, closed forms and the range of real reflectivities."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from services.retrieval.constants import CODE_RATE_HZ, SAMPLING_HZ
from services.retrieval.looks.features import read_observations
from services.retrieval.simulation.ambiguity import NOMINAL, RAW_IF, ambiguity, covariance_roots, fine_axes
from services.retrieval.simulation.dielectric import soil_permittivity, soil_reflectivity, water_reflectivity
from services.retrieval.simulation.footprint import Strength
from services.retrieval.simulation.looks import looks_table, nominal_looks, raw_if_looks
from services.retrieval.simulation.maps import NOISE_FLOOR_W, Link, simulate_maps
from services.retrieval.simulation.observations import simulate_nominal, simulate_raw_if
from services.retrieval.simulation.scattering import coherent_kernel, diffuse_kernels, kernel_index
from services.retrieval.simulation.surface import read_surface
from shared.errors import DomainError
from tests.services.retrieval import small_world


def test_reflectivity_of_moist_soil_has_the_published_values() -> None:
    found = 10 * np.log10(soil_reflectivity(np.array([0.05, 0.15, 0.30, 0.45]), np.full(4, 0.2), np.full(4, 30.0)))
    assert found == pytest.approx([-10.3, -6.7, -4.4, -3.3], abs=0.06)


def test_permittivity_of_dry_soil_is_that_of_its_minerals() -> None:
    clay = np.array([0.1, 0.3])
    index = np.sqrt(soil_permittivity(np.zeros(2), clay))
    assert index.real == pytest.approx(1.634 - 0.539 * clay + 0.2748 * clay**2, rel=1e-9)


def test_reflectivity_at_nadir_is_the_plain_fresnel_one() -> None:
    root = np.sqrt(soil_permittivity(np.array([0.2]), np.array([0.2])))
    expected = np.abs((root - 1) / (root + 1)) ** 2
    assert soil_reflectivity(np.array([0.2]), np.array([0.2]), np.array([0.0])) == pytest.approx(expected)
    assert 10 * np.log10(water_reflectivity(np.array(0.0))) == pytest.approx(-1.96, abs=0.02)


def test_ambiguity_function_is_the_codes_own_autocorrelation() -> None:
    """Against a brute-force correlation of a sampled random code with a shifted, Doppler-shifted replica."""
    rng = np.random.default_rng(0)
    code = rng.choice([-1.0, 1.0], 1023)
    time = np.arange(int(SAMPLING_HZ * 1e-3)) / SAMPLING_HZ
    for delay, doppler in ((0.0, 0.0), (0.25, 0.0), (0.5, 400.0), (0.0, 700.0), (1.5, 0.0)):
        sent = code[np.floor(time * CODE_RATE_HZ).astype(int) % 1023]
        kept = code[np.floor(time * CODE_RATE_HZ - delay).astype(int) % 1023]
        measured = np.abs(np.mean(sent * kept * np.exp(2j * np.pi * doppler * time))) ** 2
        assert float(ambiguity(np.array(delay), np.array(doppler))) == pytest.approx(measured, abs=0.02)


def test_both_modes_sample_one_fine_grid_centred_on_the_specular_point() -> None:
    delay, doppler = fine_axes()
    for grid in (NOMINAL, RAW_IF):
        row, column = grid.first_fine_bin()
        assert delay[row + grid.delays // 2 * grid.delay_stride] == 0.0
        assert doppler[column + grid.dopplers // 2 * grid.doppler_stride] == 0.0
    assert NOMINAL.delay_resolution_chips == pytest.approx(0.2552, abs=1e-4)
    assert NOMINAL.doppler_resolution_hz == 500.0
    assert coherent_kernel().max() == 1.0


def test_diffuse_kernels_start_at_the_specular_point_and_fade_with_slope() -> None:
    kernels = diffuse_kernels()
    flat, rough = (kernels[kernel_index(np.array(20.0), np.array(m), np.array(0.0))] for m in (0.006, 0.048))
    delay, _ = fine_axes()
    assert flat[delay < -1.05].max() == 0.0  # nothing arrives before the specular reflection
    assert flat.max() > 3 * rough.max()
    centre = np.unravel_index(flat.argmax(), flat.shape)
    assert -0.3 < delay[centre[0]] < 0.8


def _link(count: int) -> Link:
    full = np.full
    return Link(
        full(count, 700.0), full(count, 10.0), full(count, 6e5), full(count, 2.1e7), full(count, 25.0), full(count, 0.0)
    )


def _strength(count: int, coherent: float, diffuse: float) -> Strength:
    zero = np.zeros(count)
    return Strength(zero + coherent, zero + diffuse, zero + 0.02, zero, zero)


def test_noise_of_empty_maps_is_the_thermal_floor_over_root_looks_and_correlated() -> None:
    maps = simulate_maps(_link(4000), _strength(4000, 1e-12, 1e-12), NOMINAL, np.random.default_rng(1)) / NOISE_FLOOR_W
    assert abs(maps.mean()) < 1e-3
    assert maps.std() == pytest.approx(1 / np.sqrt(350), rel=0.02)
    neighbours = np.mean(maps[:, :-1] * maps[:, 1:]) / maps.var()
    assert neighbours == pytest.approx((1 - 0.25517) ** 2, abs=0.02)
    delay_root, doppler_root = covariance_roots(NOMINAL)
    assert (delay_root @ delay_root)[0, 1] == pytest.approx((1 - NOMINAL.delay_resolution_chips) ** 2, abs=1e-6)
    assert (doppler_root @ doppler_root)[0, 1] == pytest.approx(np.sinc(0.5) ** 2, abs=1e-6)


def test_same_seed_same_maps_other_seed_others() -> None:
    made = [simulate_maps(_link(50), _strength(50, 0.01, 0.1), RAW_IF, np.random.default_rng(s)) for s in (3, 3, 4)]
    assert np.array_equal(made[0], made[1])
    assert not np.array_equal(made[0], made[2])


def test_a_sample_never_sees_a_later_surface() -> None:
    """Wetting, burning and drowning the world after a moment changes no map taken before it."""
    start, end = small_world.SPLIT_MS, small_world.PLAN.end_ms
    world, points = small_world.surface(), small_world.points(start, end)
    moment = np.datetime64(small_world.PLAN.ignition_ms + 36 * 3_600_000, "ms")
    wet = np.where((world.time > moment)[:, None, None], np.float32(0.5), world.soil_moisture)
    later = np.where(
        np.isnat(world.burn_time) | (world.burn_time > moment), moment + np.timedelta64(1, "ms"), world.burn_time
    )
    changed = dataclasses.replace(world, soil_moisture=wet, burn_time=later)
    before = points[points["time"].dt.tz_localize(None).to_numpy() <= moment]
    one, other = (simulate_nominal(points, surface, 7) for surface in (world, changed))
    early = one.looks["time_ms"].to_numpy().astype("datetime64[ms]") <= moment
    assert early.sum() > 100 and len(before)
    assert np.array_equal(one.maps[early], other.maps[early])
    assert not np.array_equal(one.maps[~early], other.maps[~early])


def test_looks_before_the_first_state_or_off_the_grid_are_left_out_and_counted() -> None:
    start = small_world.SPLIT_MS
    points = small_world.points(start, start + 86_400_000)
    late = dataclasses.replace(small_world.surface(), time=small_world.surface().time + np.timedelta64(60, "D"))
    assert simulate_nominal(points, late, 1).without_surface == len(points)


def test_fire_changes_maps_and_leaves_unburned_ground_alone() -> None:
    start, end = small_world.SPLIT_MS, small_world.PLAN.end_ms
    world, points = small_world.surface(), small_world.points(start, end)
    unburnt = dataclasses.replace(world, burn_time=np.full_like(world.burn_time, np.datetime64("NaT", "ms")))
    burned, spared = (simulate_nominal(points, surface, 7).looks for surface in (world, unburnt))
    share = burned["burned_share"].to_numpy()
    change = (burned["coherent_db"] - spared["coherent_db"]).to_numpy()
    assert np.all(change[share == 0.0] == 0.0)
    assert (share == 1.0).sum() > 20
    assert np.abs(change[share == 1.0]).mean() > 0.5


def test_nominal_keeps_four_best_gains_and_raw_if_everything_in_the_beams() -> None:
    time = pd.Timestamp("2023-08-02T00:00:00Z")
    gains = [9.0, 3.0, 12.0, 1.0, 7.0, -4.0]
    table = small_world.points(small_world.SPLIT_MS, small_world.SPLIT_MS + 86_400_000).head(6).copy()
    table["satellite"], table["time"], table["rx_gain_dbi"] = "CYGFM01", time, gains
    table["transmitter"] = [f"G{n:02d}" for n in range(1, 7)]
    plain = looks_table(table.drop(columns="nominal"))
    assert sorted(nominal_looks(plain)["rx_gain_dbi"]) == [3.0, 7.0, 9.0, 12.0]
    flagged = looks_table(table.assign(nominal=[True, False, False, True, False, False]))
    assert sorted(nominal_looks(flagged)["rx_gain_dbi"]) == [1.0, 9.0]
    images = small_world.images_of(
        table.iloc[[0, 0, 0]].assign(time=[time, *[time + pd.Timedelta(9, "s")] * 2]), 2
    ).head(1)
    images = images.assign(status="collected")
    raw = raw_if_looks(plain, images)
    assert sorted(raw["rx_gain_dbi"]) == [1.0, 3.0, 7.0, 9.0, 12.0]
    assert raw["sample"].nunique() == 2  # a fifth look opens a further sample
    assert len(raw_if_looks(plain, images.assign(status="lost"))) == 0
    assert len(raw_if_looks(plain, images.assign(start=images["start"] + pd.Timedelta(seconds=1)))) == 0


def test_surface_file_reads_back_with_numeric_burn_times(tmp_path: Path) -> None:
    small_world.write_surface(tmp_path / "surface.nc")
    read, made = read_surface(str(tmp_path / "surface.nc")), small_world.surface()
    assert np.array_equal(read.time, made.time)
    assert np.array_equal(np.isnat(read.burn_time), np.isnat(made.burn_time))
    gap = np.abs((read.burn_time - made.burn_time)[~np.isnat(made.burn_time)].astype(int))
    assert gap.max() <= 1  # ms


def test_truncated_surface_is_named(tmp_path: Path) -> None:
    path = tmp_path / "surface.nc"
    small_world.write_surface(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(DomainError) as error:
        read_surface(str(path))
    assert error.value.field == "surface"


def test_reflectivities_fall_in_the_range_of_the_real_ones(real_data: Path, tmp_path: Path) -> None:
    """5, 50 and 95 % of reflectivity against CYGNSS over Texas (SNR plus kTB), both cut at 1 dB SNR, to 2 dB."""
    real = pd.read_parquet(real_data / "gnssr/texas_2024/CYGNSS_Texas_202403_202409.parquet")
    power_dbw = real["ddm_snr"] + 10 * np.log10(1.380649e-23 * 550 * 1000)
    eirp_dbw = real["gps_tx_power_db_w"] + real["gps_ant_gain_db_i"]
    path = real["tx_to_sp_range"].astype(float) + real["rx_to_sp_range"]
    real_db = power_dbw - eirp_dbw - real["sp_rx_gain"] + 20 * np.log10(4 * np.pi * path / 0.1903)
    start = small_world.PLAN.first_ms
    made = simulate_nominal(small_world.points(start, start + 5 * 86_400_000), small_world.surface(), 3)
    made.write(tmp_path / "nominal.nc", {})
    simulated = read_observations([tmp_path / "nominal.nc"]).looks["reflectivity_db"]
    shares = [0.05, 0.5, 0.95]
    assert real_db.quantile(shares).to_numpy() == pytest.approx([-25.9, -21.1, -15.2], abs=0.1)
    assert simulated.quantile(shares).to_numpy() == pytest.approx(real_db.quantile(shares).to_numpy(), abs=2.0)


def test_raw_if_maps_are_larger_than_nominal_and_of_the_same_reflection(tmp_path: Path) -> None:
    start = small_world.SPLIT_MS
    points = small_world.points(start, start + 86_400_000)
    made = simulate_raw_if(points, small_world.images_of(points, 40), small_world.surface(), 5)
    assert made.maps.shape[1:] == (69, 111)
    assert set(made.looks["image_id"]) <= set(range(39))  # the lost one, 39, left out
    assert made.looks["image_id"].nunique() > 35
    peaks = np.array([np.unravel_index(m.argmax(), m.shape) for m in made.maps[made.looks["snr_db"] > 6]])
    assert np.abs(peaks - [34, 55]).max(axis=0) == pytest.approx([8, 12], abs=8)
