"""The paper's three days: when, from which files, and in what weather of the season the simulation puts them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from flows.cases.paper_days import published_rows
from shared.errors import DomainError, MissingArtifactError

Box = tuple[float, float, float, float]
GRID_DEG = 0.108712  # spacing of the pre-fire grid, whose places lie on the nodes of a grid that begins at the box
CONUS_BOX: Box = (-125.064136, 24.491576, -66.572, 49.5)
COMMON_FILES = {
    "ics209": "fires/incidents_ics209_2015_2024.parquet",
    "places": "grids/conus_prefire_points.csv",
    "ndvi": "vegetation/ndvi_2001_monthly_10min.tif",
    "ndvi_range": "vegetation/ndvi_2001_minmax_10min.tif",
}


@dataclass(frozen=True)
class Orbits:
    """A file of elements of another day than the one that is planned, and the satellites of it that are left out."""

    file: str
    without: tuple[str, ...] = ()


@dataclass(frozen=True)
class PaperDay:
    """One day. ``simulated_fires`` make up for incidents that are not to be had, so that about as many active targets
    as in the paper lie in reach; temperature is that of a place 1900 m high, wind where it comes from."""

    name: str
    title: str
    published: str
    cutoff: datetime
    perimeters: str
    receivers: Orbits
    transmitters: Orbits
    simulated_fires: int
    mean_temperature_c: float
    wind_from_deg: float
    mean_wind_m_s: float
    seed: int


_LATE_2022, _JUNE_2024, _AUGUST_2025 = "orbits/tle_20221204", "orbits/tle_20240617", "orbits/omm_20250831"
DAYS = {
    "la-2025": PaperDay(
        name="la-2025",
        title="Los Angeles fires, 8 January 2025",
        published=published_rows.LA,
        cutoff=datetime(2025, 1, 8, 12, tzinfo=UTC),  # 04:00 in Los Angeles, as that day begins
        perimeters="fires/perimeters_wfigs_la_2025.parquet",
        receivers=Orbits(f"{_JUNE_2024}/cygnss.tle"),
        transmitters=Orbits(f"{_AUGUST_2025}/gps.json"),
        simulated_fires=25,
        mean_temperature_c=6.0,
        wind_from_deg=45.0,
        mean_wind_m_s=7.0,
        seed=20250108,
    ),
    "smokehouse-2024": PaperDay(
        name="smokehouse-2024",
        title="Smokehouse Creek fire, 26 February 2024",
        published=published_rows.TX,
        cutoff=datetime(2024, 2, 27, 6, tzinfo=UTC),  # midnight in Texas: the first at which the fire is known
        perimeters="fires/perimeters_wfigs_smokehouse_2024.parquet",
        receivers=Orbits(f"{_JUNE_2024}/cygnss.tle"),
        transmitters=Orbits(f"{_LATE_2022}/gps.tle"),
        simulated_fires=0,
        mean_temperature_c=9.0,
        wind_from_deg=265.0,
        mean_wind_m_s=8.0,
        seed=20240226,
    ),
    "conus-2023-07-05": PaperDay(
        name="conus-2023-07-05",
        title="Most fires south of 35° N in a day, 5 July 2023",
        published=published_rows.CONUS,
        cutoff=datetime(2023, 7, 5, 12, tzinfo=UTC),
        perimeters="fires/perimeters_wfigs_conus_202307.parquet",
        receivers=Orbits(f"{_LATE_2022}/cygnss.tle", ("CYGFM06",)),  # silent since the end of November 2022
        transmitters=Orbits(f"{_LATE_2022}/gps.tle"),
        simulated_fires=95,
        mean_temperature_c=21.0,
        wind_from_deg=225.0,
        mean_wind_m_s=4.5,
        seed=20230705,
    ),
}


def day_of(name: str) -> PaperDay:
    """The day of a case name; DomainError if there is none."""
    if name not in DAYS:
        raise DomainError(f"'{name}' is no day of the paper.", field="case", value=name, accepted=", ".join(DAYS))
    return DAYS[name]


def sources(day: PaperDay, data_root: Path) -> dict[str, Path]:
    """The files of a day; MissingArtifactError names one that the data folder lacks."""
    named = COMMON_FILES | {"perimeters": day.perimeters}
    named |= {"receivers": day.receivers.file, "transmitters": day.transmitters.file}
    for relative in named.values():
        if not (data_root / relative).is_file():
            raise MissingArtifactError(
                f"The data folder lacks '{relative}', which the case {day.name} needs.",
                field="data_root",
                value=relative,
                accepted="a SMOKEGLINT_DATA folder",
            )
    return {name: data_root / relative for name, relative in named.items()}
