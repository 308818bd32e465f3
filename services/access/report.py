"""What a reader must know to judge a prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from services.access.coverage.places import REPORTED_RADII_KM
from services.access.coverage.revisit import Revisits, summary
from services.access.coverage.robustness import AT_EPOCH_KM, DRAG_SHARE, PER_DAY_KM, expected_error
from services.access.events.contacts import Station
from services.access.orbits import statement
from services.access.orbits.ephemeris import RECEIVER_NODE_S, TRANSMITTER_NODE_S
from services.access.orbits.formats import Orbit
from services.access.orbits.orientation import orientation_at
from services.access.orbits.preparation import left_out_warnings, missing_constellations
from services.access.prediction import Access
from services.access.specular.tracks import PairCounts


@dataclass
class Tally:
    """What was written, counted while receivers came in one after the other."""

    opportunities: int = 0
    images: int = 0
    robust: int = 0
    cell_opportunities: int = 0
    cell_images: int = 0
    specular_points: int = 0


def report(
    access: Access,
    tally: Tally,
    targets: Revisits | None = None,
    cells: Revisits | None = None,
    stations: Sequence[Station] = (),
) -> dict[str, Any]:
    """Ages, errors, what was left out, method, counts, coverage and revisits; ``access.satellites`` hold the events."""
    horizon = access.horizon
    return {
        "start": horizon.start.isoformat(),
        "duration_s": horizon.duration_s,
        "step_s": horizon.step_s,
        "receivers": [_receiver_row(orbit, access) for orbit in access.receivers],
        "transmitters": [_orbit_row(orbit, access) for orbit in access.transmitters],
        "stations": [_station_row(station) for station in stations],
        "dropped": access.dropped,
        "warnings": warnings(access),
        "position_error": {"gps_sgp4": statement.GPS_POSITION_ERROR, "receivers": _along_track(access)},
        "method": _method(access),
        "counts": {
            "targets": access.target_count,
            "targets_covered": 0 if targets is None else targets.covered,
            "opportunities": tally.opportunities,
            "images": tally.images,
            "opportunities_robust": tally.robust,
            "cells": 0 if access.grid is None else len(access.grid),
            "cells_covered": 0 if cells is None else cells.covered,
            "cell_opportunities": tally.cell_opportunities,
            "cell_images": tally.cell_images,
            "specular_points": tally.specular_points,
            "contacts": sum(len(found.contacts) for found in access.satellites),
            "contacts_too_short": sum(len(found.short_contacts) for found in access.satellites),
            "eclipses": sum(len(found.eclipses) for found in access.satellites),
            "pairs": _pairs([found.counts for found in access.satellites]),
        },
        "coverage": {"targets": _coverage(targets), "cells": _coverage(cells)},
        "revisit": {
            "targets": None if targets is None else summary(targets.frame()),
            "cells": None if cells is None else summary(cells.frame()),
        },
        "specular_angle_max_deg": max((found.worst_angle_deg for found in access.satellites), default=0.0),
    }


def _station_row(station: Station) -> dict[str, Any]:
    """How a station's numbers were understood."""
    mask = station.azimuth_mask
    horizon = (
        None if mask is None else [list(pair) for pair in zip(mask.azimuths_deg, mask.elevations_deg, strict=True)]
    )
    return {
        "station": station.name,
        "datum": station.datum,
        "up": station.up,
        "mask_deg": station.mask_deg,
        "azimuth_mask_deg": horizon,
    }


def _coverage(places: Revisits | None) -> dict[str, Any] | None:
    """The share of places that a specular point came near, by radius (km), for each day."""
    return None if places is None else {"share_within_km_by_day": places.covered_share(REPORTED_RADII_KM)}


def _pairs(counts: list[PairCounts]) -> dict[str, int]:
    """What became of every receiver, transmitter and instant; the numbers add up to all of them."""
    names = {
        "kept": "within_incidence_limit",
        "beyond_limit": "beyond_incidence_limit",
        "occulted": "occulted",
        "uncertified": "grazing_not_certified",
        "skipped": "not_looked_at_far_from_what_matters",
    }
    rows = [asdict(count) for count in counts]
    return {label: sum(row[name] for row in rows) for name, label in names.items()}


def _method(access: Access) -> dict[str, Any]:
    horizon, options = access.horizon, access.options
    antennas = options.antennas
    return {
        "propagation": "SGP4; TEME to ITRF by GMST82, UT1 and polar motion of IERS finals2000A; tables by splines "
        "of degree 9",
        "between_nodes": f"cubic Hermite, nodes of {RECEIVER_NODE_S:g} s (receivers, within 0.05 m) and "
        f"{TRANSMITTER_NODE_S:g} s (transmitters, within 0.25 m)",
        "min_contact_s": options.min_contact_s,
        "constellations": options.constellations,
        "earth_orientation_in_table": orientation_at(horizon.start, horizon.duration_s).in_table,
        "specular_points": f"WGS84, height {options.surface_height_m:g} m, at the receiver's time (no light time)",
        "mode": options.mode,
        "covered_by": "first Fresnel zone over one second of motion" if options.by_footprint else "radius",
        "target_radius_km": options.radius_km,
        "max_incidence_deg": options.max_incidence_deg,
        "antennas": {
            "name": antennas.name,
            "tilt_deg": {antenna.name: antenna.tilt_deg for antenna in antennas.antennas},
            "channels": antennas.channels,
            "in_beam_above_dbi": antennas.floor_dbi,
        },
        "nominal_channels": f"the {antennas.channels} of highest gain within the incidence limit",
    }


def _along_track(access: Access) -> dict[str, Any]:
    """The along-track error assumed for receivers."""
    given = access.options.along_track_error_km
    if given is not None:
        return {"along_track_km": given, "from": "input"}
    law = f"{AT_EPOCH_KM:g} km + {PER_DAY_KM:g} km/day x age + {DRAG_SHARE:g} x drag's displacement since the epoch"
    return {"along_track_km": law, "from": "age of the elements"}


def _orbit_row(orbit: Orbit, access: Access) -> dict[str, Any]:
    return statement.orbit_row(orbit, access.horizon.start, access.interpolation_m)


def _receiver_row(orbit: Orbit, access: Access) -> dict[str, Any]:
    """With the along-track error expected at the start and the end, where nothing better is known."""
    row = _orbit_row(orbit, access)
    law = expected_error(orbit, access.horizon.start, access.options.along_track_error_km)
    if row["expected_position_error_km"] is None and law is not None:
        at_start, at_end = law.at(np.array([0.0, access.horizon.duration_s])).round(2).tolist()
        row["expected_position_error_km"] = {"along_track_at_start": at_start, "along_track_at_end": at_end}
    return row


def warnings(access: Access) -> list[str]:
    """What may make the prediction worse than it looks: ages of orbits, satellites left out, short contacts."""
    start, duration_s = access.horizon.start, access.horizon.duration_s
    in_table = orientation_at(start, duration_s).in_table
    beyond = [] if in_table else ["UT1 and polar motion: the horizon lies beyond the shipped IERS table"]
    used = (*access.receivers, *access.transmitters)
    return [
        *statement.orbit_warnings(used, start),
        *left_out_warnings(access.dropped),
        *missing_constellations(access.transmitters, access.options.constellations),
        *_short_contacts(access),
        *beyond,
    ]


def _short_contacts(access: Access) -> list[str]:
    least = access.options.min_contact_s
    start = access.horizon.start
    return [
        f"contact of {row.satellite} with {row.station} at {start + timedelta(seconds=row.start_s):%Y-%m-%dT%H:%M:%SZ} "
        f"left out: {row.end_s - row.start_s:.1f} s is shorter than the {least:g} s asked for"
        for found in access.satellites
        for row in found.short_contacts
    ]
