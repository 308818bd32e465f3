"""One bundle of the live case: what the ingest has kept by a cut-off, and the rest simulated or empty, and said."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd

from flows.cases.bundle import Case, Provenance, iso, write_case
from flows.cases.constellation import ELEMENTS, constellation_provenance, write_ground_and_spacecraft
from flows.cases.live import fires, kept, weather
from flows.cases.moved_elements import write_moved
from flows.cases.nature.land import fuels_dataset
from flows.cases.nature.run import NatureRun, burn_grid, make_nature
from flows.cases.nature.setting import Setting
from flows.cases.nature.soil import smap_table, surface_dataset
from flows.cases.nature.weather import analysis_dataset, forecast_dataset
from flows.cases.simulated import with_points, write_plain_table
from flows.ingest.taking import Taken
from shared.contracts import tables
from shared.contracts.grids import FUELS, write_netcdf
from shared.contracts.schema import write_table
from shared.errors import DomainError

NAME = "live"
SEED = 1
Box = fires.Box
SHIPPED = {"receivers": "cygnss_20250831.json", "transmitters": "gps_20250831.json"}
ANALYSIS_DAYS = 3


@dataclass
class _Bundle:
    """A bundle in the making: its folder, its frame, and where each input came from."""

    root: Path
    ingested: Path
    cutoff: datetime
    setting: Setting
    origins: dict[str, Provenance] = field(default_factory=dict)

    def real(self, logical: str, source: str, taken: list[Taken], more: str = "") -> None:
        oldest = min(one.data_time for one in taken)
        self.origins[logical] = Provenance(False, kept.said(source, taken, self.cutoff) + more, oldest)

    def simulated(self, logical: str, why: str, oldest: datetime | None = None) -> None:
        self.origins[logical] = Provenance(True, why, oldest or self.setting.start)


def build_live(ingested: Path, folder: Path, area: Box, cutoff: datetime) -> Case:
    """Make the bundle of a cut-off (UTC) for a box in degrees from what is kept under ``ingested``.

    Real where kept data are not too old: elements, incidents, detections, weather. Older data than their limit are used
    and called stale; where nothing can be used, elements and weather are simulated, incidents and detections empty.
    Fuels, soil moisture and the surface for the simulator are simulated always.
    """
    folder.mkdir(parents=True, exist_ok=True)
    made = _Bundle(folder, ingested, cutoff, setting_of(area, cutoff))
    run = make_nature(made.setting)
    for logical in SHIPPED:
        _write_elements(made, logical)
    write_ground_and_spacecraft(folder, cutoff, made.setting.cycle_hours * 3600)
    made.origins |= constellation_provenance(cutoff)
    _write_incidents(made, area)
    _write_detections(made, area)
    _write_weather(made, run)
    _write_simulated(made, run)
    files = {name: f"{name}.parquet" for name in ("stations", "incidents", "detections", "smap")}
    files |= {name: f"{name}.nc" for name in ("weather_analysis", "weather_forecast", "fuels")}
    files |= {name: f"{name}.json" for name in ("receivers", "transmitters", "spacecraft")}
    return write_case(
        folder,
        name=NAME,
        title=f"Live, from {iso(cutoff)}: {_title(made.origins)}",
        simulated=False,
        region=area,
        first_cutoff=cutoff,
        cycles=1,
        cycle_hours=made.setting.cycle_hours,
        inputs=files,
        nature={"surface": "surface.nc"},
        provenance=made.origins,
    )


def setting_of(area: Box, cutoff: datetime) -> Setting:
    """The nature that stands in for what nobody fetched: the same ground for every bundle of an area."""
    wide = max(area[2] - area[0], area[3] - area[1])
    step = 0.25 if wide <= 10 else 1.0
    return Setting(
        region=area,
        first_cutoff=cutoff,
        seed=SEED,
        cycles=1,
        pre_days=14,
        weather_step_deg=step,
        fuels_step_deg=step / 5,
        soil_step_deg=step / 5,
        burn_step_deg=step / 25,
    )


def _title(origins: dict[str, Provenance]) -> str:
    """What of a bundle is real, in words."""
    told = {"weather_forecast": "weather"}
    asked = ("receivers", "transmitters", "incidents", "detections", "weather_forecast")
    real = [name for name in asked if not origins[name].simulated and not origins[name].source.startswith("none")]
    named = ", ".join(told.get(name, name) for name in real)
    return f"real {named}; the rest simulated" if named else "nothing real: no fires, the rest simulated"


def _write_elements(made: _Bundle, logical: str) -> None:
    taken = kept.newest(logical, made.ingested, made.cutoff)
    target = made.root / f"{logical}.json"
    if taken is not None:
        shutil.copyfile(taken.path, target)
        made.real(logical, logical, [taken])
        return
    oldest = write_moved(ELEMENTS / SHIPPED[logical], made.cutoff, target)
    why = "no elements of the last 30 days: those of 2025-08-31 moved to the cut-off, places on the orbits simulated"
    made.simulated(logical, why, oldest)


def _write_incidents(made: _Bundle, area: Box) -> None:
    taken = kept.pages("incidents", made.ingested, made.cutoff)
    table = fires.incidents_of([one.path for one in taken], area, made.cutoff)
    write_table(made.root / "incidents.parquet", with_points(table), tables.INCIDENTS)
    if taken:
        made.real("incidents", "incidents", taken, f"; {len(table)} burning in the area")
    else:
        why = "none: no list of incidents of the last three days was kept; the table is empty"
        made.origins["incidents"] = Provenance(False, why, made.cutoff)


def _write_detections(made: _Bundle, area: Box) -> None:
    firms, hms = (kept.newest(f"detections-{name}", made.ingested, made.cutoff) for name in ("firms", "hms"))
    found = fires.detections_of(firms.path if firms else None, hms.path if hms else None, area, made.cutoff)
    write_table(made.root / "detections.parquet", with_points(found), tables.DETECTIONS)
    taken = [one for one in (firms, hms) if one is not None]
    if taken:
        told = "; ".join(kept.said(one.source, [one], made.cutoff) for one in taken)
        oldest = min(one.data_time for one in taken)
        made.origins["detections"] = Provenance(False, f"{told}; {len(found)} fire points in the area", oldest)
    else:
        why = "none: no fire points of the last three days were kept; the table is empty"
        made.origins["detections"] = Provenance(False, why, made.cutoff)


def _write_weather(made: _Bundle, run: NatureRun) -> None:
    """HRRR where kept files reach beyond the cut-off, else the nature run's weather."""
    setting, names = made.setting, ("weather_analysis", "weather_forecast")
    longitude, latitude = setting.axes(setting.weather_step_deg)
    sources = weather.lead_files(made.ingested)
    taken = [one for name in sources if (one := kept.newest(name, made.ingested, made.cutoff)) is not None]
    problem = "no weather of the last 48 h was kept"
    try:
        moments = [weather.read_moment(one, longitude, latitude) for one in taken]
    except DomainError as error:
        moments, problem = [], str(error)
    if moments and max(moment.valid for moment in moments) > made.cutoff:
        analysis, forecast = weather.weather_datasets(moments, longitude, latitude)
        hours = (max(moment.valid for moment in moments) - made.cutoff).total_seconds() / 3600
        for name, dataset in zip(names, (analysis, forecast), strict=True):
            write_netcdf(made.root / f"{name}.nc", dataset, {"simulated": False})
            made.real(name, "hrrr", taken, f"; reaches {hours:.0f} h beyond it, straight lines between lead hours")
        return
    if moments:
        problem = "the kept weather ends before the cut-off"
    analysis = analysis_dataset(run.weather, setting.cutoff_h - 24 * ANALYSIS_DAYS, setting.cutoff_h)
    for name, dataset in zip(names, (analysis, forecast_dataset(run.weather)), strict=True):
        write_netcdf(made.root / f"{name}.nc", dataset, {"simulated": True})
        made.simulated(name, f"{problem}: simulated, seed {setting.seed}")


def _write_simulated(made: _Bundle, run: NatureRun) -> None:
    setting, marked = made.setting, {"simulated": True}
    write_netcdf(made.root / "fuels.nc", FUELS.check(fuels_dataset(setting, run.land)), marked)
    surface = surface_dataset(setting, run.land, run.weather, burn_grid(setting, ()), iso(setting.start))
    write_netcdf(made.root / "surface.nc", surface, marked)
    write_plain_table(made.root / "smap.parquet", smap_table(setting, run.land, run.weather))
    for name in ("fuels", "surface", "smap"):
        made.simulated(name, f"simulated, seed {setting.seed}: no adapter reads it into a case")


def ages(case: Case, now: datetime) -> pd.DataFrame:
    """Each input of a bundle: simulated or not, the age of its oldest datum in hours, and its source."""
    rows = [
        {"input": name, "simulated": origin.simulated, "age_h": (now - origin.oldest).total_seconds() / 3600,
         "source": origin.source}
        for name, origin in sorted(case.provenance.items())
    ]  # fmt: skip
    return pd.DataFrame(rows)


def utc_minute(moment: datetime) -> datetime:
    """The full minute that has begun: what live cut-offs fall on."""
    return moment.astimezone(UTC).replace(second=0, microsecond=0)
