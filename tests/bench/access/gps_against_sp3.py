"""GPS by SGP4 against IGS orbits: ``python -m tests.bench.access.gps_against_sp3 [picture.png]``.

Needs SMOKEGLINT_DATA. Prints distances by age of the elements and by direction, and draws them where a file is named.
"""

from __future__ import annotations

import itertools
import os
import sys
from datetime import timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.access.orbits.elements import ElementSet
from services.access.orbits.ephemeris import propagate
from services.access.orbits.formats import read_orbits
from services.access.orbits.orientation import EARTH_ROTATION_RAD_S
from services.access.orbits.preparation import name_transmitters
from tests.services.access.truth import sp3_orbits

Array = NDArray[np.float64]

SP3_FILE = "IGS0OPSRAP_20223380000_01D_15M_ORB.SP3"
ELEMENTS = ("tle_20221204", "tle_20220505")
AGE_EDGES_DAYS = (-1.1, -0.5, 0.0, 0.5, 1.0, 1.5)
SPIN = np.array([0.0, 0.0, EARTH_ROTATION_RAD_S])


def differences(data: Path, folder: str) -> dict[str, Array]:
    """By satellite: age (days), and SGP4 minus IGS radially, along and across the track (km), at each epoch (n, 4)."""
    truth = sp3_orbits(data, SP3_FILE)
    first = next(iter(truth.values())).first
    named, _ = name_transmitters(read_orbits((data / "orbits" / folder / "gps.tle").read_text()), first)
    sets = {each.name: each for each in named if isinstance(each, ElementSet) and each.name in truth}
    times = next(iter(truth.values())).segments[0].times_s
    orbits, _ = propagate(list(sets.values()), first, float(times[-1]), 60.0)
    found: dict[str, Array] = {}
    for orbit in orbits:
        position, velocity = orbit.states(times)
        inertial = velocity + np.cross(SPIN, position)
        radial = position / np.linalg.norm(position, axis=1, keepdims=True)
        across = np.cross(position, inertial)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        axes = np.stack([radial, np.cross(across, radial), across], axis=1)
        apart = np.einsum("nij,nj->ni", axes, position - truth[orbit.name].segments[0].position_m) / 1000.0
        age = [sets[orbit.name].age_days(first + timedelta(seconds=float(t))) for t in times]
        found[orbit.name] = np.column_stack([age, apart])
    return found


def table(rows: Array) -> list[str]:
    """Lines of a Markdown table: median, 95th percentile and largest distance by age."""
    distance = np.linalg.norm(rows[:, 1:], axis=1)
    lines = ["| age (days) | positions | median (km) | 95 % (km) | largest (km) |", "|---|---|---|---|---|"]
    for low, high in itertools.pairwise(AGE_EDGES_DAYS):
        mine = distance[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if len(mine):
            figures = f"{np.median(mine):.2f} | {np.percentile(mine, 95):.2f} | {mine.max():.2f}"
            lines.append(f"| {low:g} to {high:g} | {len(mine)} | {figures} |")
    return lines


def draw(found: dict[str, Array], path: str) -> None:
    """Distance over the day, a line for each satellite."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    axes = figure.add_subplot()
    for rows in found.values():
        axes.plot(
            np.arange(len(rows)) / 4.0, np.linalg.norm(rows[:, 1:], axis=1), color="C0", alpha=0.45, linewidth=0.9
        )
    axes.set_xlabel("hours of 2022-12-04 (GPS time)")
    axes.set_ylabel("SGP4 from IGS rapid orbits (km)")
    axes.set_xlim(0, 24)
    axes.set_ylim(0, None)
    axes.grid(color="0.9")
    figure.savefig(path, dpi=100, metadata={"Software": None})


def main() -> None:
    """Print the tables; draw where asked."""
    data = Path(os.environ["SMOKEGLINT_DATA"])
    for folder in ELEMENTS:
        found = differences(data, folder)
        rows = np.concatenate(list(found.values()))
        distance = np.linalg.norm(rows[:, 1:], axis=1)
        print(f"{folder}: {len(found)} satellites, ages {rows[:, 0].min():.2f} to {rows[:, 0].max():.2f} days")
        print(
            f"median {np.median(distance):.3f} km, 95 % {np.percentile(distance, 95):.2f}, largest {distance.max():.2f}"
        )
        print("rms radial, along, across (km):", np.sqrt((rows[:, 1:] ** 2).mean(axis=0)).round(2).tolist())
        if folder == ELEMENTS[0]:
            print("\n".join(table(rows)))
            if sys.argv[1:]:
                draw(found, sys.argv[1])


if __name__ == "__main__":
    main()
