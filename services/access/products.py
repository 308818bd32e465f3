"""Access predictions as the tables and the report that other services read."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from services.access.ellipsoid import to_geodetic
from services.access.orbits import statement
from services.access.orbits.formats import Orbit
from services.access.orbits.orientation import orientation_at
from services.access.orbits.preparation import left_out_warnings, missing_constellations
from services.access.prediction import Access, Area, Horizon, SatelliteAccess, step_times


def opportunities_frame(access: Access, target_id: NDArray[np.int64]) -> pd.DataFrame:
    """A row per image and target (contract ``opportunities``); images numbered by satellite, then time.

    ``target_id`` (n,) belongs to the targets as given to ``predict``. Images that cover no target have no number.
    """
    parts: list[pd.DataFrame] = []
    first_image = 0
    for found in access.satellites:
        coverage, track = found.coverage, found.track
        new_image = np.diff(coverage.time_index, prepend=-1) != 0
        image = first_image - 1 + np.cumsum(new_image)
        first_image += int(new_image.sum())
        point = coverage.point
        parts.append(
            pd.DataFrame(
                {
                    "image_id": image.astype(np.int32),
                    "satellite": np.full(len(point), track.satellite, dtype=object),
                    "time": step_times(access.horizon, coverage.time_index),
                    "target_id": target_id[coverage.target_row],
                    "transmitter": _codes(access)[track.transmitter[point]],
                    "incidence_deg": track.incidence_deg[point],
                    "distance_km": coverage.distance_km,
                    "rx_gain_dbi": track.rx_gain_dbi[point],
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def specular_points_frame(access: Access) -> geopandas.GeoDataFrame:
    """The specular tracks (contract ``specular_points``) with ``nominal``: one of the four channels of highest gain."""
    parts: list[pd.DataFrame] = []
    for found in access.satellites:
        track = found.track
        latitude, longitude, _ = to_geodetic(track.position_m)
        kept = _inside(latitude, longitude, access.options.area)
        parts.append(
            pd.DataFrame(
                {
                    "satellite": np.full(int(kept.sum()), track.satellite, dtype=object),
                    "transmitter": _codes(access)[track.transmitter[kept]],
                    "time": step_times(access.horizon, track.time_index[kept]),
                    "geometry": shapely.points(longitude[kept], latitude[kept]),
                    "incidence_deg": track.incidence_deg[kept],
                    "rx_gain_dbi": track.rx_gain_dbi[kept],
                    "rx_range_m": track.rx_range_m[kept],
                    "tx_range_m": track.tx_range_m[kept],
                    "nominal": track.nominal[kept],
                }
            )
        )
    return geopandas.GeoDataFrame(pd.concat(parts, ignore_index=True), geometry="geometry", crs="EPSG:4326")


def contacts_frame(access: Access) -> pd.DataFrame:
    """Contacts (contract ``contacts``); edges rounded inwards to milliseconds, so that no part claimed is below."""
    rows = [contact for found in access.satellites for contact in found.contacts]
    return pd.DataFrame(
        {
            "satellite": pd.Series([row.satellite for row in rows], dtype=object),
            "station": pd.Series([row.station for row in rows], dtype=object),
            "start": _edges(access.horizon, [row.start_s for row in rows], np.ceil),
            "end": _edges(access.horizon, [row.end_s for row in rows], np.floor),
            "max_elevation_deg": pd.Series([row.max_elevation_deg for row in rows], dtype=np.float64),
        }
    )


def eclipses_frame(access: Access) -> pd.DataFrame:
    """Eclipses (contract ``eclipses``); edges rounded outwards to milliseconds, so that no shadow is left out."""
    rows = [eclipse for found in access.satellites for eclipse in found.eclipses]
    return pd.DataFrame(
        {
            "satellite": pd.Series([row.satellite for row in rows], dtype=object),
            "start": _edges(access.horizon, [row.start_s for row in rows], np.floor),
            "end": _edges(access.horizon, [row.end_s for row in rows], np.ceil),
            "kind": pd.Series([row.kind for row in rows], dtype=object),
        }
    )


def report(access: Access, target_count: int) -> dict[str, Any]:
    """What a reader must know to judge the prediction: ages, errors, what was left out, and counts."""
    horizon, options = access.horizon, access.options
    covered = [found.coverage.target_row for found in access.satellites]
    in_table = orientation_at(horizon.start, horizon.duration_s).in_table
    return {
        "start": horizon.start.isoformat(),
        "duration_s": horizon.duration_s,
        "step_s": horizon.step_s,
        "receivers": [_orbit_row(orbit, access) for orbit in access.receivers],
        "transmitters": [_orbit_row(orbit, access) for orbit in access.transmitters],
        "dropped": access.dropped,
        "warnings": warnings(access),
        "position_error": {"gps_sgp4": statement.GPS_POSITION_ERROR, "receivers": None},
        "method": {
            "propagation": "SGP4; TEME to ITRF by GMST82, UT1 and polar motion of IERS finals2000A; tables by splines "
            "of degree 9",
            "min_contact_s": options.min_contact_s,
            "constellations": options.constellations,
            "earth_orientation_in_table": in_table,
            "specular_points": "WGS84, height 0, at the receiver's time (light time left out)",
            "target_radius_km": options.target_radius_km,
            "max_incidence_deg": options.max_incidence_deg,
            "beams": vars(options.beams),
            "nominal_channels": "the four of highest gain within the incidence limit",
        },
        "counts": {
            "targets": target_count,
            "targets_covered": len(np.unique(np.concatenate(covered))),
            "opportunities": int(sum(len(rows) for rows in covered)),
            "images": int(sum(len(np.unique(found.coverage.time_index)) for found in access.satellites)),
            "contacts": sum(len(found.contacts) for found in access.satellites),
            "contacts_too_short": sum(len(found.short_contacts) for found in access.satellites),
            "eclipses": sum(len(found.eclipses) for found in access.satellites),
            "grazing_pairs_left_out": sum(found.track.grazing for found in access.satellites),
        },
        "specular_angle_max_deg": max((_worst_angle(found) for found in access.satellites), default=0.0),
    }


def _worst_angle(found: SatelliteAccess) -> float:
    return float(found.track.mismatch_deg.max(initial=0.0))


def _orbit_row(orbit: Orbit, access: Access) -> dict[str, Any]:
    return statement.orbit_row(orbit, access.horizon.start, access.interpolation_m)


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


def _codes(access: Access) -> NDArray[np.object_]:
    return np.array([element.name for element in access.transmitters], dtype=object)


def _inside(latitude: NDArray[np.float64], longitude: NDArray[np.float64], area: Area | None) -> NDArray[np.bool_]:
    if area is None:
        return np.ones(len(latitude), dtype=np.bool_)
    west, south, east, north = area
    after, before = longitude >= west, longitude <= east
    across = after & before if west < east else after | before
    return np.asarray((latitude >= south) & (latitude <= north) & across)


def _edges(horizon: Horizon, seconds: list[float], rounding: np.ufunc) -> pd.DatetimeIndex:
    # the edge search stops within a microsecond; rounding an exact second must not lose a millisecond to that
    milliseconds = rounding(np.round(np.asarray(seconds, dtype=np.float64) * 1000.0, 2)).astype("timedelta64[ms]")
    start_ms = np.datetime64(horizon.start.replace(tzinfo=None), "ms")
    return pd.DatetimeIndex(start_ms + milliseconds).tz_localize("UTC")
