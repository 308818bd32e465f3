"""Readers of what the access tests are held against: a GMAT run and IGS orbits."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.access.events.contacts import Station, find_contacts
from services.access.events.eclipses import find_eclipses
from services.access.orbits.elements import ElementSet
from services.access.orbits.ephemeris import Ephemeris, propagate
from services.access.orbits.formats import read_orbits
from services.access.orbits.preparation import name_transmitters
from services.access.orbits.tabulated import TabulatedOrbit, interpolate

# The stations of cygfm01.script: StateType = Spherical, MinimumElevationAngle; kilometres there, metres here
GMAT_STATIONS = (
    Station("1", 0, 0, 0, 7, "spherical"),
    Station("2", 45, 45, 350, 15, "spherical"),
    Station("3", 45, 315, 100, 30, "spherical"),
    Station("4", -45, 45, 1000, 0, "spherical"),
    Station("5", -45, 315, 10000, 10, "spherical"),
    Station("6", 90, 90, 500, 7, "spherical"),
    Station("7", -90, 180, 500, 7, "spherical"),
)


def _time(text: str) -> datetime:
    return datetime.strptime(text, "%d %b %Y %H:%M:%S.%f").replace(tzinfo=UTC)


def gmat_oem(folder: Path) -> str:
    """GMAT's 10 s Cartesian track (EarthMJ2000Eq, km) as a CCSDS OEM, digits as printed."""
    lines = [line for line in (folder / "Cartesian.txt").read_text().splitlines()[1:] if line.strip()]
    states = [f"{_time(line[:24]):%Y-%m-%dT%H:%M:%S.%f} {' '.join(line[24:].split())}" for line in lines]
    head = (
        "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2025-12-16T00:00:00\nORIGINATOR = GMAT\n\nMETA_START\n"
        "OBJECT_NAME = CYGFM01\nOBJECT_ID = 2016-078D\nCENTER_NAME = EARTH\nREF_FRAME = EME2000\nTIME_SYSTEM = UTC\n"
        f"START_TIME = {states[0].split()[0]}\nSTOP_TIME = {states[-1].split()[0]}\nMETA_STOP\n"
    )
    return head + "\n".join(states) + "\n"


def gmat_ephemeris(folder: Path) -> Ephemeris:
    """GMAT's track, through the OEM reader."""
    (orbit,) = read_orbits(gmat_oem(folder))
    assert isinstance(orbit, TabulatedOrbit)
    span_s = (orbit.last - orbit.first).total_seconds()
    (ephemeris,), dropped, _ = interpolate([orbit], orbit.first, span_s, 10.0)
    assert not dropped
    return ephemeris


def gmat_rows(file: Path, start: datetime) -> list[tuple[float, float, str]]:
    """Start, end (s after ``start``) and the rest of each event line of a GMAT report."""
    return [
        ((_time(line[:24]) - start).total_seconds(), (_time(line[28:52]) - start).total_seconds(), line[52:])
        for line in file.read_text().splitlines()
        if line[:1].isdigit()
    ]


def gmat_contact_differences_s(folder: Path) -> NDArray[np.float64]:
    """Ours minus GMAT's (k, 2) for every contact; raises where the numbers of contacts differ."""
    orbit = gmat_ephemeris(folder)
    end_s = float(orbit.times_s[-1])
    differences = []
    for station in GMAT_STATIONS:
        expected = gmat_rows(folder / f"ContactLocator{station.name}.txt", orbit.start)
        found = find_contacts(orbit, [station], end_s)
        assert len(found) == len(expected), f"station {station.name}: {len(found)} contacts, GMAT {len(expected)}"
        differences += [(a.start_s - b[0], a.end_s - b[1]) for a, b in zip(found, expected, strict=True)]
    return np.array(differences)


def gmat_eclipse_differences_s(folder: Path) -> NDArray[np.float64]:
    """Ours minus GMAT's (k, 2) for every umbra and penumbra; raises where order or kinds differ."""
    orbit = gmat_ephemeris(folder)
    expected = gmat_rows(folder / "EclipseLocator1.txt", orbit.start)
    found = find_eclipses(orbit, float(orbit.times_s[-1]))
    assert [row.kind for row in found] == [row[2].split()[2].lower() for row in expected]
    return np.array([(a.start_s - b[0], a.end_s - b[1]) for a, b in zip(found, expected, strict=True)])


def gps_sp3_distances_km(data: Path) -> dict[str, NDArray[np.float64]]:
    """Distances of SGP4 (elements of 2022-12) from IGS rapid orbits of 2022-12-04, by satellite."""
    truth = sp3_orbits(data, "IGS0OPSRAP_20223380000_01D_15M_ORB.SP3")
    elements = read_orbits((data / "orbits/tle_20221204/gps.tle").read_text())
    first = next(iter(truth.values())).first
    span_s = float(next(iter(truth.values())).segments[0].times_s[-1])
    named, _ = name_transmitters(elements, first)
    orbits, _ = propagate([each for each in named if isinstance(each, ElementSet)], first, span_s, 60.0)
    return {
        orbit.name: np.linalg.norm(
            orbit.states(truth[orbit.name].segments[0].times_s)[0] - truth[orbit.name].segments[0].position_m, axis=1
        )
        / 1000.0
        for orbit in orbits
        if orbit.name in truth
    }


def sp3_orbits(data: Path, name: str) -> dict[str, TabulatedOrbit]:
    """The satellites of one of the SP3 files, through the SP3 reader."""
    orbits = read_orbits((data / "orbits/sp3" / name).read_text())
    return {orbit.name: orbit for orbit in orbits if isinstance(orbit, TabulatedOrbit)}
