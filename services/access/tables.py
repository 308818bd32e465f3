"""Access predictions as the tables that other services read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import geopandas
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from services.access.coverage.revisit import Visits
from services.access.coverage.seen import Seen
from services.access.ellipsoid import to_geodetic
from services.access.horizon import Horizon
from services.access.prediction import Access
from services.access.satellite import SatelliteAccess
from services.access.specular.tracks import PairCounts, SpecularTrack

PART_ROWS = 500_000


class OpportunityParts:
    """Opportunities of one receiver after the other (contract ``opportunities``): a row per image and place.

    ``place_id`` (n,) belongs to the places as given. Images are numbered by receiver, then time; those that cover
    nothing have no number.
    """

    def __init__(self, access: Access, place_id: NDArray[np.int64]) -> None:
        self._horizon = access.horizon
        self._codes = [orbit.name for orbit in access.transmitters]
        self._place_id = place_id
        self.images = 0

    def parts(self, satellite: str, seen: Seen) -> Iterator[pd.DataFrame]:
        """The rows of the next receiver, at most ``PART_ROWS`` at a time."""
        new_image = np.diff(seen.time_index, prepend=-1) != 0
        image = self.images - 1 + np.cumsum(new_image)
        self.images += int(new_image.sum())
        for first in range(0, len(image), PART_ROWS):
            rows = slice(first, first + PART_ROWS)
            yield self._frame(satellite, seen, rows, image[rows])

    def empty(self) -> pd.DataFrame:
        """The columns without rows."""
        none = np.zeros(0)
        flags, index = none.astype(np.bool_), none.astype(np.int32)
        seen = Seen(
            0, 0, Visits(index, index, index, index), index, index, none.astype(np.int16), none, none, none,
            none.astype(np.float32), flags, flags, none,
        )  # fmt: skip
        return self._frame("", seen, slice(0, 0), index)

    def _frame(self, satellite: str, seen: Seen, rows: slice, image: NDArray[np.int64]) -> pd.DataFrame:
        count = len(image)
        error = np.full(count, np.nan) if seen.error_km is None else seen.error_km[rows]
        return pd.DataFrame(
            {
                "image_id": image.astype(np.int32),
                "satellite": pd.Categorical.from_codes(np.zeros(count, dtype=np.int8), [satellite]),
                "time": self._horizon.times(seen.time_index[rows]),
                "target_id": self._place_id[seen.row[rows]],
                "transmitter": pd.Categorical.from_codes(seen.transmitter[rows], self._codes),
                "incidence_deg": seen.incidence_deg[rows],
                "distance_km": seen.distance_km[rows],
                "rx_gain_dbi": seen.rx_gain_dbi[rows],
                "covered_ahead": _known(seen.ahead, rows, count),
                "covered_behind": _known(seen.behind, rows, count),
                "along_track_error_km": error,
            }
        )


def _known(flags: NDArray[np.bool_] | None, rows: slice, count: int) -> pd.Series:
    if flags is None:
        return pd.Series(pd.NA, index=range(count), dtype="boolean")
    return pd.Series(flags[rows])


def opportunities_frame(access: Access, target_id: NDArray[np.int64]) -> pd.DataFrame:
    """The opportunities of all receivers at once."""
    parts = OpportunityParts(access, target_id)
    seen = [found for found in access.satellites if found.targets is not None]
    frames = [part for found in seen for part in parts.parts(found.satellite, found.targets)]
    frame = pd.concat([parts.empty(), *frames], ignore_index=True) if frames else parts.empty()
    return frame.astype({"satellite": object, "transmitter": object})


def specular_points_parts(access: Access, found: SatelliteAccess) -> Iterator[geopandas.GeoDataFrame]:
    """The specular track of one receiver (contract ``specular_points``), at most ``PART_ROWS`` at a time, with
    ``nominal``: one of the channels of highest gain, and ``in_beam``: gain above the antennas' floor."""
    track = found.track
    if track is None:
        return
    for first in range(0, len(track), PART_ROWS):
        yield _points(access, track.where(slice(first, first + PART_ROWS)))


def _points(access: Access, track: SpecularTrack) -> geopandas.GeoDataFrame:
    latitude, longitude, _ = to_geodetic(track.position_m)
    return geopandas.GeoDataFrame(
        {
            "satellite": pd.Categorical.from_codes(np.zeros(len(track), dtype=np.int8), [track.satellite]),
            "transmitter": pd.Categorical.from_codes(track.transmitter, [orbit.name for orbit in access.transmitters]),
            "time": access.horizon.times(track.time_index),
            "geometry": shapely.points(longitude, latitude),
            "incidence_deg": track.incidence_deg,
            "rx_gain_dbi": track.rx_gain_dbi,
            "rx_range_m": track.rx_range_m,
            "tx_range_m": track.tx_range_m,
            "nominal": track.nominal,
            "in_beam": track.in_beam,
        },
        geometry="geometry",
        crs="EPSG:4326",
    )


def no_specular_points(access: Access) -> geopandas.GeoDataFrame:
    """The columns of ``specular_points`` without rows."""
    none = np.zeros(0)
    track = SpecularTrack(
        "", none.astype(np.int32), none.astype(np.int32), np.zeros((0, 3)), none, none, none, none, none,
        none.astype(np.bool_), none.astype(np.bool_), PairCounts(0, 0, 0, 0, 0),
    )  # fmt: skip
    return _points(access, track)


def specular_points_frame(access: Access) -> geopandas.GeoDataFrame:
    """The specular tracks of all receivers at once."""
    parts = [part for found in access.satellites for part in specular_points_parts(access, found)]
    frame = pd.concat([no_specular_points(access), *parts], ignore_index=True)
    texts = frame.astype({"satellite": object, "transmitter": object})
    return geopandas.GeoDataFrame(texts, geometry="geometry", crs="EPSG:4326")


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


def _edges(horizon: Horizon, seconds: Sequence[float], rounding: np.ufunc) -> pd.DatetimeIndex:
    # the edge search stops within a microsecond; rounding an exact second must not lose a millisecond to that
    milliseconds = rounding(np.round(np.asarray(seconds, dtype=np.float64) * 1000.0, 2))
    return horizon.at(milliseconds.astype(np.int64))
