"""The product's own simulated case, in two sizes: real orbits and stations, everything else a nature run."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pandas as pd

from flows.cases.bundle import Case, Provenance, iso, write_case
from flows.cases.constellation import (
    ELEMENTS_OLDEST,
    constellation_provenance,
    copy_elements,
    write_ground_and_spacecraft,
)
from flows.cases.nature.land import fuels_dataset
from flows.cases.nature.overpasses import observe
from flows.cases.nature.run import NatureRun, burn_grid, incident_reports, incidents_table, make_nature, truth_dataset
from flows.cases.nature.setting import Ignition, Setting
from flows.cases.nature.soil import smap_table, surface_dataset
from flows.cases.nature.weather import analysis_dataset, forecast_dataset
from shared.contracts import tables
from shared.contracts.grids import FUELS, write_netcdf
from shared.contracts.schema import write_table
from shared.errors import DomainError

FIRST_CUTOFF = datetime(2025, 9, 1, 12, tzinfo=UTC)  # 05:00 in Arizona; the day's passes lie on both sides of it
ANALYSIS_DAYS = 10  # of weather before the first cut-off
LOOKS_BEFORE_H = 48.0  # of detections before the first cut-off
DEFAULT_SEED = 20250901
SIZES = ("tiny", "demo")
SIMULATED_NAMES = (
    "incidents",
    "incident_reports",
    "detections",
    "weather_analysis",
    "weather_forecast",
    "fuels",
    "smap",
    "surface",
    "truth",
)


def setting_of(size: str, seed: int = DEFAULT_SEED) -> Setting:
    """The setting of a size, around the Mogollon Rim and the White Mountains in Arizona; DomainError if unknown."""
    if size == "tiny":
        return Setting(
            region=(-110.4, 33.3, -109.2, 34.5),
            first_cutoff=FIRST_CUTOFF,
            seed=seed,
            weather_step_deg=0.3,
            fuels_step_deg=0.1,
            soil_step_deg=0.05,
            burn_step_deg=0.005,
            ignitions=(
                Ignition("SIM001", "Simulated Canyon", -109.95, 33.72, -39.3, half_width_km=22.0),
                Ignition("SIM002", "Simulated Mesa", -109.6, 34.16, 1.6, half_width_km=14.0),
            ),
        )
    if size == "demo":
        return Setting(
            region=(-111.2, 32.2, -108.2, 35.2),
            first_cutoff=FIRST_CUTOFF,
            seed=seed,
            ignitions=(
                Ignition("SIM001", "Simulated Canyon", -110.35, 33.25, -54.4, half_width_km=25.0),
                Ignition("SIM002", "Simulated Mesa", -109.1, 34.05, -38.8, half_width_km=22.0),
                Ignition("SIM003", "Simulated Rim", -110.5, 34.4, -19.2, 3.0, half_width_km=20.0),
                Ignition("SIM004", "Simulated Creek", -109.05, 32.85, 2.1, 3.0, half_width_km=16.0),
            ),
        )
    raise DomainError(
        f"There is no simulated case of size '{size}'.", field="size", value=size, accepted=" | ".join(SIZES)
    )


def build_simulated_case(size: str, folder: str | Path, seed: int = DEFAULT_SEED) -> Case:
    """Make the simulated case ``tiny`` or ``demo`` in a folder (made if need be): the same seed, the same bytes."""
    setting = setting_of(size, seed)
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    run = make_nature(setting)
    copy_elements(root)
    write_ground_and_spacecraft(root, setting.first_cutoff, setting.cycle_hours * 3600)
    _write_tables(root, run)
    _write_grids(root, run)
    return write_case(
        root,
        name=f"simulated-{size}",
        title=f"Simulated fires on the Mogollon Rim, Arizona ({size}): real orbits, simulated nature",
        simulated=True,
        region=setting.region,
        first_cutoff=setting.first_cutoff,
        cycles=setting.cycles,
        cycle_hours=setting.cycle_hours,
        inputs={
            "receivers": "receivers.json",
            "transmitters": "transmitters.json",
            "stations": "stations.parquet",
            "spacecraft": "spacecraft.json",
            "incidents": "incidents.parquet",
            "incident_reports": "incident_reports.parquet",
            "detections": "detections.parquet",
            "weather_analysis": "weather_analysis.nc",
            "weather_forecast": "weather_forecast.nc",
            "fuels": "fuels.nc",
            "smap": "smap.parquet",
        },
        nature={"surface": "surface.nc", "truth": "truth.nc"},
        provenance=_provenance(setting),
    )


def _write_tables(root: Path, run: NatureRun) -> None:
    setting, simulated = run.setting, {"simulated": True}
    incidents, reports = incidents_table(run), incident_reports(run)
    write_table(root / "incidents.parquet", incidents, tables.INCIDENTS, simulated)
    write_plain_table(root / "incident_reports.parquet", reports)
    known = {row.incident_id: _hours(setting, row.known_at) for row in incidents.itertuples()}
    looks = observe(setting, list(run.fires), known, setting.cutoff_h - LOOKS_BEFORE_H)
    write_table(root / "detections.parquet", with_points(looks), tables.DETECTIONS, simulated)
    write_plain_table(root / "smap.parquet", smap_table(setting, run.land, run.weather))


def _write_grids(root: Path, run: NatureRun) -> None:
    setting = run.setting
    analysis = analysis_dataset(run.weather, setting.cutoff_h - 24 * ANALYSIS_DAYS, setting.end_h)
    marked = {"simulated": True}
    write_netcdf(root / "weather_analysis.nc", analysis, marked)
    write_netcdf(root / "weather_forecast.nc", forecast_dataset(run.weather), marked)
    across, up = setting.mesh(setting.fuels_step_deg)
    wetness = run.weather.storms.rain_mm(across, up, setting.cutoff_h - 480.0, setting.cutoff_h)
    fuels = FUELS.check(fuels_dataset(setting, run.land, wetness=wetness))
    write_netcdf(root / "fuels.nc", fuels, marked)
    reference = iso(setting.start)
    surface = surface_dataset(setting, run.land, run.weather, burn_grid(setting, run.fires), reference)
    write_netcdf(root / "surface.nc", surface, marked)
    write_netcdf(root / "truth.nc", truth_dataset(setting, run.fires, reference), marked)


def with_points(table: pd.DataFrame) -> pd.DataFrame:
    """The table with its ``longitude_deg`` and ``latitude_deg`` turned into a point geometry."""
    import geopandas

    points = geopandas.points_from_xy(table.longitude_deg.round(6), table.latitude_deg.round(6))
    return geopandas.GeoDataFrame(table.drop(columns=["longitude_deg", "latitude_deg"]), geometry=points, crs=4326)


def write_plain_table(path: Path, table: pd.DataFrame) -> None:
    """A Parquet table that no contract covers, with times as ``timestamp[ms, UTC]``."""
    stamped = table.copy()
    for name in stamped.columns:
        if isinstance(stamped[name].dtype, pd.DatetimeTZDtype):
            stamped[name] = stamped[name].astype("datetime64[ms, UTC]")
    stamped.to_parquet(path, index=False, compression="zstd")


def _hours(setting: Setting, time: pd.Timestamp) -> float:
    return (time - pd.Timestamp(setting.start)).total_seconds() / 3600.0


def _provenance(setting: Setting) -> dict[str, Provenance]:
    orbits = "general-perturbation elements of 2025-08-31 (CelesTrak / Space-Track, 18 SPCS)"
    codes = f"{orbits}; PRN by catalogue number as CelesTrak gave it in December 2022"
    made = f"nature run, seed {setting.seed}"
    return {
        **constellation_provenance(setting.first_cutoff),
        "receivers": Provenance(False, orbits, datetime(2025, 8, 31, 12, 41, 16, tzinfo=UTC)),
        "transmitters": Provenance(False, codes, ELEMENTS_OLDEST),
        **{name: Provenance(True, made, setting.start) for name in SIMULATED_NAMES},
    }
