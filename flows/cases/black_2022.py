"""The real case: the Black Fire, New Mexico, May 2022, from the project's data folder."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd

from flows.cases.bundle import Case, Provenance, iso, write_case
from flows.cases.constellation import constellation_provenance, write_ground_and_spacecraft
from flows.cases.hms import derived_no_fire, hms_fires, read_elements
from flows.cases.nature.land import fuels_dataset
from flows.cases.nature.run import NatureRun, burn_grid, make_nature, truth_dataset
from flows.cases.nature.setting import FloatArray, Setting
from flows.cases.nature.soil import smap_table, surface_dataset
from flows.cases.nature.spread import FireGrid
from flows.cases.nature.weather import analysis_dataset, forecast_dataset
from flows.cases.simulated import ANALYSIS_DAYS, with_points, write_plain_table
from flows.cases.vegetation import ndvi_at
from flows.cases.wfigs import area_reports, arrival_between, trusted_perimeters
from shared.contracts import tables
from shared.contracts.grids import FUELS, write_netcdf
from shared.contracts.schema import write_table
from shared.errors import MissingArtifactError

REGION = (-108.9, 32.4, -107.0, 34.1)
PERIOD = ("2022-05-14", "2022-05-31")
FIRST_CUTOFF = datetime(2022, 5, 16, tzinfo=UTC)
ELEMENTS_TIME = datetime(2022, 5, 5, tzinfo=UTC)
KNOWN_AFTER = pd.Timedelta(hours=6)  # stated, not measured: from discovery to the first public incident record
ELEMENTS = "orbits/tle_20220505"
SOURCES = {
    "perimeters": "fires/perimeters_wfigs_black_2022.parquet",
    "detections": "fires/detections_hms_conus_20220405_20220717.parquet",
    "receivers": f"{ELEMENTS}/cygnss.tle",
    "transmitters": f"{ELEMENTS}/gps.tle",
    "overpasses": f"{ELEMENTS}/viirs_modis.tle",
    "ndvi": "vegetation/ndvi_2001_monthly_10min.tif",
    "ndvi_range": "vegetation/ndvi_2001_minmax_10min.tif",
}


def build_black_2022(
    data_root: str | Path, folder: str | Path, *, cycles: int = 2, first_cutoff: datetime = FIRST_CUTOFF
) -> Case:
    """Make the Black Fire case in a folder; MissingArtifactError names a file that the data folder lacks.

    Real: elements, stations, HMS fire points, WFIGS perimeters and incident, NDVI (of 2001). Derived: no-fire looks.
    Simulated and marked so: weather, fuels other than NDVI, soil moisture, and the surface for the DDM simulator,
    whose burn times are shared out between the perimeters.
    """
    source = _sources(Path(data_root))
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    setting = _setting(first_cutoff, cycles)
    run = make_nature(setting)
    shutil.copyfile(source["receivers"], root / "receivers.tle")
    shutil.copyfile(source["transmitters"], root / "transmitters.tle")
    write_ground_and_spacecraft(root, first_cutoff, setting.cycle_hours * 3600)
    fire = _write_fire(root, source, setting)
    nodes = setting.mesh(setting.fuels_step_deg)
    _write_simulated(root, run, fire, ndvi_at(source["ndvi"], source["ndvi_range"], 5, *nodes))
    files = {name: f"{name}.parquet" for name in ("stations", "incidents", "incident_reports", "detections")}
    files |= {name: f"{name}.parquet" for name in ("smap", "perimeters")}
    files |= {name: f"{name}.nc" for name in ("weather_analysis", "weather_forecast", "fuels")}
    return write_case(
        root,
        name="black-2022",
        title="Black Fire, New Mexico, May 2022: real detections, perimeters and orbits; simulated weather and maps",
        simulated=False,
        region=REGION,
        first_cutoff=first_cutoff,
        cycles=cycles,
        cycle_hours=setting.cycle_hours,
        inputs=files
        | {"receivers": "receivers.tle", "transmitters": "transmitters.tle", "spacecraft": "spacecraft.json"},
        nature={"surface": "surface.nc", "truth": "truth.nc"},
        provenance=_provenance(setting),
    )


def _sources(data_root: Path) -> dict[str, Path]:
    paths = {name: data_root / relative for name, relative in SOURCES.items()}
    for name, path in paths.items():
        if not path.is_file():
            raise MissingArtifactError(
                f"The data folder lacks '{SOURCES[name]}', which the Black Fire case needs.",
                field="data_root",
                value=SOURCES[name],
                accepted="a SMOKEGLINT_DATA folder",
            )
    return paths


def _setting(first_cutoff: datetime, cycles: int) -> Setting:
    return Setting(
        region=REGION,
        first_cutoff=first_cutoff,
        seed=20220514,
        cycles=cycles,
        mean_temperature_c=19.0,
        wet_until_days=17.0,
        wind_from_deg=240.0,
        wind_to_from_deg=265.0,
        wind_shift_h=30.0,
        mean_wind_m_s=5.5,
    )


def _write_fire(root: Path, source: dict[str, Path], setting: Setting) -> FireGrid:
    """Write perimeters, incident, reports and detections; give the arrival that lies between the perimeters."""
    perimeters = trusted_perimeters(source["perimeters"], "Black")
    write_table(root / "perimeters.parquet", perimeters, tables.PERIMETERS)
    discovered, origin = _discovery(source["perimeters"])
    incident = pd.DataFrame(
        {
            "incident_id": [perimeters.incident_id.iloc[0]],
            "name": ["Black"],
            "start": [discovered],
            "area_km2": [np.nan],
            "known_at": [discovered + KNOWN_AFTER],
        }
    )
    point = geopandas.points_from_xy([origin[0]], [origin[1]])
    incidents = geopandas.GeoDataFrame(incident, geometry=point, crs=4326)
    write_table(root / "incidents.parquet", incidents, tables.INCIDENTS)
    write_plain_table(root / "incident_reports.parquet", area_reports(perimeters))
    fires = hms_fires(source["detections"], REGION, *PERIOD)
    looks = derived_no_fire(fires, read_elements(source["overpasses"]), origin)
    detections = pd.concat([fires, looks], ignore_index=True).sort_values(
        ["time", "satellite"], kind="stable", ignore_index=True
    )
    write_table(root / "detections.parquet", with_points(detections), tables.DETECTIONS)
    return arrival_between(perimeters, origin, discovered, setting.start, epsg=setting.utm_epsg)


def _discovery(path: Path) -> tuple[pd.Timestamp, tuple[float, float]]:
    """When the fire was discovered, and its initial point (longitude, latitude in degrees)."""
    table = pd.read_parquet(path, columns=["incident", "discovered", "initial_lat_deg", "initial_lon_deg"])
    record = table[table.incident == "Black"].to_dict("records")[0]
    return pd.Timestamp(record["discovered"]), (float(record["initial_lon_deg"]), float(record["initial_lat_deg"]))


def _write_simulated(root: Path, run: NatureRun, fire: FireGrid, ndvi: dict[str, FloatArray]) -> None:
    setting, marked = run.setting, {"simulated": True}
    analysis = analysis_dataset(run.weather, setting.cutoff_h - 24 * ANALYSIS_DAYS, setting.end_h)
    write_netcdf(root / "weather_analysis.nc", analysis, marked)
    write_netcdf(root / "weather_forecast.nc", forecast_dataset(run.weather), marked)
    write_netcdf(root / "fuels.nc", FUELS.check(fuels_dataset(setting, run.land, ndvi)), marked)
    reference = iso(setting.start)
    surface = surface_dataset(setting, run.land, run.weather, burn_grid(setting, (fire,)), reference)
    write_netcdf(root / "surface.nc", surface, marked)
    derived = {"simulated": True, "source": "shared out between WFIGS perimeters; no observation"}
    write_netcdf(root / "truth.nc", truth_dataset(setting, (fire,), reference), derived)
    write_plain_table(root / "smap.parquet", smap_table(setting, run.land, run.weather))


def _provenance(setting: Setting) -> dict[str, Provenance]:
    discovered = datetime(2022, 5, 14, 3, 30, tzinfo=UTC)
    made = f"simulated, seed {setting.seed}"
    orbits = "two-line elements of 2022-05-05 (CelesTrak): 9 to 25 days old during the fire"
    hms = (
        "NOAA HMS VIIRS and MODIS points, delivery taken as 3 h after the overpass, confidence not given; "
        "no-fire looks derived from satellite passes (column derived)"
    )
    wfigs = "NIFC WFIGS"
    between = "burn times shared out between WFIGS perimeters (so not independent of them); soil and vegetation " + made
    simulated = ("weather_analysis", "weather_forecast", "smap")
    return {
        **constellation_provenance(setting.first_cutoff),
        "receivers": Provenance(False, orbits, ELEMENTS_TIME),
        "transmitters": Provenance(False, orbits, ELEMENTS_TIME),
        "incidents": Provenance(False, f"{wfigs}; taken as known 6 h after discovery", discovered),
        "incident_reports": Provenance(False, f"{wfigs}, known when scraped", discovered),
        "perimeters": Provenance(False, f"{wfigs}, scraped less than 36 h after their time", discovered),
        "detections": Provenance(False, hms, discovered),
        "fuels": Provenance(True, f"NDVI of 2001 (MODIS); all else {made}", datetime(2001, 1, 1, tzinfo=UTC)),
        "surface": Provenance(True, between, setting.start),
        "truth": Provenance(True, between, setting.start),
        **{name: Provenance(True, made, setting.start) for name in simulated},
    }
