"""A day of the paper as a case: real fires, everything that is not to be had of that day simulated and marked."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd

from flows.cases.bundle import Case, Provenance, iso, write_case
from flows.cases.constellation import constellation_provenance, write_ground_and_spacecraft
from flows.cases.moved_elements import write_moved
from flows.cases.nature.land import WATER, fuels_dataset
from flows.cases.nature.run import NatureRun, make_nature
from flows.cases.nature.setting import Setting
from flows.cases.nature.soil import smap_table, surface_dataset
from flows.cases.nature.weather import analysis_dataset, forecast_dataset
from flows.cases.paper_days import burning, incidents
from flows.cases.paper_days.days import CONUS_BOX, GRID_DEG, Box, PaperDay, day_of, sources
from flows.cases.paper_days.published_rows import rows_of
from flows.cases.simulated import with_points, write_plain_table
from flows.cases.vegetation import ndvi_at
from shared.contracts import tables
from shared.contracts.grids import FUELS, write_netcdf
from shared.contracts.schema import write_table

OUTSIDE = 249  # USGS code: no place of the pre-fire grid
ANALYSIS_DAYS = 3
SMAP_EVERY = 4  # of the 9 km cells, in rows and columns: a regression over the country needs no more


@dataclass(frozen=True)
class Steps:
    """Spacing of the simulated grids in degrees, and of the fires' in m; fuels lie on the pre-fire grid."""

    weather: float = 1.0
    fuels: float = GRID_DEG
    soil: float = 0.5
    burn: float = 0.02
    fire_m: float = 250.0


def build_paper_day(
    name: str, data_root: str | Path, folder: str | Path, *, region: Box = CONUS_BOX, steps: Steps | None = None
) -> Case:
    """Make the case of a day in a folder; MissingArtifactError names a file that the data folder lacks.

    Real: incidents and perimeters of WFIGS, incidents of ICS-209, stations, NDVI (of 2001), the places of pre-fire
    targets. Simulated and marked so: where the satellites are on their orbits, weather, fuels, soil, detections, and
    as many fires as the day lacks.
    """
    day = day_of(name)
    source = sources(day, Path(data_root))
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    setting = setting_of(day, region, steps or Steps())
    run = make_nature(setting)
    oldest = {
        which: write_moved(source[which], day.cutoff, root / f"{which}.json", orbits.without)
        for which, orbits in (("receivers", day.receivers), ("transmitters", day.transmitters))
    }
    write_ground_and_spacecraft(root, day.cutoff, setting.cycle_hours * 3600)
    (root / "published_rows.json").write_text(json.dumps(rows_of(day.published), indent=1) + "\n", encoding="utf-8")
    fires = _write_fires(root, source, day, setting)
    _write_grids(root, run, fires, source, day.cutoff.month)
    named = ("stations", "incidents", "incident_reports", "detections", "perimeters", "smap")
    files = {table: f"{table}.parquet" for table in named}
    files |= {grid: f"{grid}.nc" for grid in ("weather_analysis", "weather_forecast", "fuels")}
    files |= {
        document: f"{document}.json" for document in ("receivers", "transmitters", "spacecraft", "published_rows")
    }
    return write_case(
        root,
        name=day.name,
        title=f"{day.title}: real fires; weather, satellite positions and detections simulated",
        simulated=False,
        region=region,
        first_cutoff=day.cutoff,
        cycles=setting.cycles,
        cycle_hours=setting.cycle_hours,
        inputs=files,
        nature={"surface": "surface.nc"},
        provenance=_provenance(day, setting, oldest, fires.table),
    )


def setting_of(day: PaperDay, region: Box, steps: Steps) -> Setting:
    """The nature of a day: one cycle, a week before it, and no ignitions, for the fires are real."""
    return Setting(
        region=region,
        first_cutoff=day.cutoff,
        seed=day.seed,
        cycles=1,
        pre_days=7,
        issue_every_h=24,
        weather_step_deg=steps.weather,
        fuels_step_deg=steps.fuels,
        soil_step_deg=steps.soil,
        burn_step_deg=steps.burn,
        cell_m=steps.fire_m,
        mean_temperature_c=day.mean_temperature_c,
        wet_until_days=5.0,
        wind_from_deg=day.wind_from_deg,
        wind_to_from_deg=day.wind_from_deg + 30.0,
        mean_wind_m_s=day.mean_wind_m_s,
    )


@dataclass(frozen=True)
class _Fires:
    table: pd.DataFrame
    burning: list[burning.FireGrid]


def _write_fires(root: Path, source: dict[str, Path], day: PaperDay, setting: Setting) -> _Fires:
    """Write incidents, reports, perimeters and detections; give the incidents and how the mapped ones burn."""
    mapped = geopandas.read_parquet(source["perimeters"])
    end = day.cutoff + timedelta(hours=setting.cycle_hours)
    real = incidents.in_box(incidents.wfigs_fires(mapped, day.cutoff, end), setting.region)
    reported = incidents.ics209_fires(source["ics209"], real, day.cutoff, setting.region)
    made = incidents.simulated_fires(source["ics209"], day.simulated_fires, day.cutoff, setting.region, day.seed)
    fires = pd.concat([part for part in (real, reported, made) if len(part)], ignore_index=True)
    write_table(root / "incidents.parquet", with_points(fires), tables.INCIDENTS)
    write_plain_table(root / "incident_reports.parquet", incidents.reported_areas(mapped, real))
    write_table(root / "perimeters.parquet", _perimeters(mapped, real), tables.PERIMETERS)
    shown = burning.burning_fires(mapped, real, setting)
    looks = burning.simulated_detections(setting, shown, real)
    write_table(root / "detections.parquet", with_points(looks), tables.DETECTIONS, {"simulated": True})
    return _Fires(fires, shown)


def _perimeters(mapped: geopandas.GeoDataFrame, real: pd.DataFrame) -> geopandas.GeoDataFrame:
    """The outlines of the day's fires as they were published: dated and known when scraped, whatever they say."""
    own = (
        mapped[mapped["unique_fire_id"].isin(real["incident_id"])]
        .to_crs(4326)
        .sort_values(["scraped", "unique_fire_id"])
    )
    own = own.drop_duplicates(["unique_fire_id", "scraped"], keep="last")
    columns = {"incident_id": own["unique_fire_id"].astype(str), "time": own["scraped"], "known_at": own["scraped"]}
    shapes = [burning.polygonal(shape) for shape in own.geometry]
    return geopandas.GeoDataFrame(pd.DataFrame(columns), geometry=shapes, crs=4326).reset_index(drop=True)


def _write_grids(root: Path, run: NatureRun, fires: _Fires, source: dict[str, Path], month: int) -> None:
    setting, marked = run.setting, {"simulated": True}
    analysis = analysis_dataset(run.weather, setting.cutoff_h - 24 * ANALYSIS_DAYS, setting.end_h)
    write_netcdf(root / "weather_analysis.nc", analysis, marked)
    write_netcdf(root / "weather_forecast.nc", forecast_dataset(run.weather), marked)
    across, up = setting.mesh(setting.fuels_step_deg)
    fuels = fuels_dataset(setting, run.land, ndvi_at(source["ndvi"], source["ndvi_range"], month, across, up))
    places = pd.read_csv(source["places"])
    sea = np.where(fuels["ndvi_max"].to_numpy() < 0, WATER, OUTSIDE)
    code = np.where(_chosen(places, setting), 0, sea).astype(np.uint8)
    fuels["mask_code"] = (("latitude", "longitude"), code)
    write_netcdf(root / "fuels.nc", FUELS.check(fuels), marked)
    burned = burning.burn_times(setting, fires.burning)
    surface = surface_dataset(setting, run.land, run.weather, burned, iso(setting.start))
    write_netcdf(root / "surface.nc", surface, marked)
    write_plain_table(root / "smap.parquet", smap_table(setting, run.land, run.weather, SMAP_EVERY))


def _chosen(places: pd.DataFrame, setting: Setting) -> np.ndarray:
    """The fuels' nodes (latitude, longitude) next to the places of the pre-fire grid (columns lon_deg, lat_deg)."""
    longitude, latitude = setting.axes(setting.fuels_step_deg)
    columns = np.rint((places["lon_deg"] - longitude[0]) / setting.fuels_step_deg).astype(int).to_numpy()
    rows = np.rint((places["lat_deg"] - latitude[0]) / setting.fuels_step_deg).astype(int).to_numpy()
    inside = (columns >= 0) & (columns < len(longitude)) & (rows >= 0) & (rows < len(latitude))
    chosen = np.zeros((len(latitude), len(longitude)), dtype=bool)
    chosen[rows[inside], columns[inside]] = True
    return chosen


def _provenance(
    day: PaperDay, setting: Setting, oldest: dict[str, datetime], fires: pd.DataFrame
) -> dict[str, Provenance]:
    made = f"simulated, seed {setting.seed}"
    first = fires["start"].min().to_pydatetime().astimezone(UTC)
    count = fires["origin"].str.split(",").str[0].value_counts()
    listed = ", ".join(f"{count.get(name, 0)} of {name}" for name in ("WFIGS", "ICS-209"))
    known = "known 6 h after discovery (ICS-209: once its date was over); column origin says which"
    orbits = "moved to the day at secular rates: planes right to some degrees, places on the orbit simulated"
    simulated = ("weather_analysis", "weather_forecast", "smap")
    burnt = "burn times shared out between WFIGS outlines; soil and vegetation " + made
    between = f"looks simulated over fires that burn between WFIGS outlines, seed {setting.seed}"
    return {
        **constellation_provenance(day.cutoff),
        "receivers": Provenance(True, f"elements of {day.receivers.file} {orbits}", oldest["receivers"]),
        "transmitters": Provenance(True, f"elements of {day.transmitters.file} {orbits}", oldest["transmitters"]),
        "incidents": Provenance(
            bool(fires["simulated"].any()), f"{listed}, {int(fires['simulated'].sum())} simulated; {known}", first
        ),
        "incident_reports": Provenance(False, "NIFC WFIGS, known when scraped", first),
        "perimeters": Provenance(False, "NIFC WFIGS, dated and known when scraped", first),
        "published_rows": Provenance(False, "the paper's Table 1", day.cutoff),
        "detections": Provenance(True, between, setting.start),
        "fuels": Provenance(True, f"NDVI of 2001 (MODIS); all else {made}", datetime(2001, 1, 1, tzinfo=UTC)),
        "surface": Provenance(True, burnt, setting.start),
        **{name: Provenance(True, made, setting.start) for name in simulated},
    }
