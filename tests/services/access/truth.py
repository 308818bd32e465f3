"""Readers of what the access tests are held against: a GMAT run and IGS orbits."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.access.events.contacts import Station, find_contacts
from services.access.events.eclipses import find_eclipses
from services.access.orbits.elements import name_transmitters, read_elements
from services.access.orbits.ephemeris import Ephemeris, propagate
from services.access.orbits.orientation import j2000_to_itrf, orientation_at

GPS_MINUS_UTC_S = 18.0

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


def gmat_ephemeris(folder: Path) -> Ephemeris:
    """GMAT's 10 s Cartesian track (EarthMJ2000Eq, km) in ITRF."""
    lines = [line for line in (folder / "Cartesian.txt").read_text().splitlines()[1:] if line.strip()]
    times = [_time(line[:24]) for line in lines]
    states = np.array([[float(number) for number in line[24:].split()] for line in lines]) * 1000.0
    t_s = np.array([(time - times[0]).total_seconds() for time in times])
    position, velocity = j2000_to_itrf(states[:, :3], states[:, 3:], t_s, orientation_at(times[0], float(t_s[-1])))
    return Ephemeris("CYGFM01", times[0], float(t_s[1]), position, velocity)


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


def sp3_positions(file: Path) -> tuple[datetime, NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """First epoch (UTC), seconds after it, and positions (n, 3) in metres by satellite of an SP3 file in GPS time."""
    times: list[datetime] = []
    positions: dict[str, list[list[float]]] = {}
    for line in file.read_text().splitlines():
        if line.startswith("*"):
            year, month, day, hour, minute = (int(number) for number in line.split()[1:6])
            times.append(datetime(year, month, day, hour, minute, tzinfo=UTC))
        elif line.startswith("P"):
            positions.setdefault(line[1:4], []).append([float(number) * 1000.0 for number in line[4:46].split()])
    t_s = np.array([(time - times[0]).total_seconds() for time in times])
    first = datetime.fromtimestamp(times[0].timestamp() - GPS_MINUS_UTC_S, tz=UTC)
    return first, t_s, {name: np.array(rows) for name, rows in positions.items()}


def gps_sp3_distances_km(data: Path) -> dict[str, NDArray[np.float64]]:
    """Distances of SGP4 (elements of 2022-12) from IGS rapid orbits of 2022-12-04, by satellite."""
    first, t_s, truth = sp3_positions(data / "orbits/sp3/IGS0OPSRAP_20223380000_01D_15M_ORB.SP3")
    elements = read_elements((data / "orbits/tle_20221204/gps.tle").read_text())
    orbits, _ = propagate(name_transmitters(elements, first)[0], first, float(t_s[-1]), 60.0)
    return {
        orbit.name: np.linalg.norm(orbit.states(t_s)[0] - truth[orbit.name], axis=1) / 1000.0
        for orbit in orbits
        if orbit.name in truth
    }
