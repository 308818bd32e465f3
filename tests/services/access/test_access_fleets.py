"""Lists of receivers pick their satellites from larger files, and the shipped ones are what they say."""

from __future__ import annotations

from pathlib import Path

import pytest

from services.access.fleets import SHIPPED, read_fleet, shipped_fleet
from services.access.orbits.formats import read_orbits
from shared.errors import DomainError
from tests.services.access.orbits import RECEIVERS, TRANSMITTERS

FLEETS = Path(__file__).parents[3] / "services/access/fleets"


def test_the_cygnss_list_names_the_satellites_of_the_catalogue(real_data: Path) -> None:
    """Catalogue numbers and names agree with every set of real elements; FM06 is not on the list."""
    fleet = shipped_fleet("cygnss")
    for folder in ("tle_20200730", "tle_20221204", "tle_20240617", "tle_20260702"):
        orbits = read_orbits((real_data / "orbits" / folder / "cygnss.tle").read_text())
        picked, missing = fleet.pick(orbits)
        assert not missing and len(picked) == 7
        named = {orbit.catalogue_number: orbit.name for orbit in orbits}
        assert all(named[orbit.catalogue_number] == orbit.name for orbit in picked)
        assert "CYGFM06" not in {orbit.name for orbit in picked}


def test_a_fleet_is_picked_from_a_catalogue_by_number_and_renamed() -> None:
    fleet = read_fleet({"satellites": [{"satellite": "MINE", "catalogue_number": 41885}, {"satellite": "GONE"}]})
    picked, missing = fleet.pick(read_orbits(RECEIVERS + TRANSMITTERS))
    assert [(orbit.name, orbit.catalogue_number) for orbit in picked] == [("MINE", 41885)]
    assert list(missing) == ["GONE"]
    with pytest.raises(DomainError, match="not one of the 10 orbits"):
        fleet.pick(read_orbits(TRANSMITTERS))


def test_only_the_names_that_a_fleet_takes_must_be_unique() -> None:
    """Catalogues are full of satellites of one name; a list by number does not mind, one by that name does."""
    orbits = read_orbits(RECEIVERS.replace("CYGFM04", "CYGFM05") + TRANSMITTERS)
    by_number = read_fleet({"satellites": [{"satellite": "X", "catalogue_number": 41885}]})
    assert [orbit.where for orbit in by_number.pick(orbits)[0]] == ["line 5"]
    with pytest.raises(DomainError, match="name CYGFM05 is given twice, in line 2 and line 5"):
        read_fleet({"satellites": [{"satellite": "CYGFM05"}]}).pick(orbits)


def test_the_example_says_that_it_is_one() -> None:
    fleet = shipped_fleet("example_commercial")
    assert fleet.example and "EXAMPLE" in fleet.name
    assert fleet.constellations == ("G", "E", "C", "J")
    orbits = read_orbits((FLEETS / "example_commercial.omm").read_text())
    picked, missing = fleet.pick(orbits)
    assert not missing and all(orbit.name.startswith("EXAMPLE") for orbit in picked)
    assert all(not shipped_fleet(name).example for name in SHIPPED if "example" not in name)


@pytest.mark.parametrize(
    ("document", "what"),
    [
        ([], "not a list of satellites"),
        ({"satellites": []}, "not a list of satellites"),
        ({"satellites": [{"satellite": "A"}, {"name": "B"}]}, "row 1 names no satellite"),
        ({"satellites": [{"satellite": "A", "catalogue_number": "41884"}]}, "row 0 names no satellite"),
        ({"satellites": [{"satellite": "A"}, {"satellite": "A", "catalogue_number": 1}]}, "given twice"),
        ({"satellites": [{"satellite": n, "catalogue_number": 1} for n in "AB"]}, r"B \(1\) is given twice.*row 1"),
        ({"satellites": [{"satellite": "A"}], "constellations": ["GLONASS"]}, "GLONASS"),
    ],
)
def test_a_broken_list_is_named(document: object, what: str) -> None:
    with pytest.raises(DomainError, match=what):
        read_fleet(document)
