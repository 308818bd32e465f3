"""Access predictions as the tables that other services read."""

from __future__ import annotations

from collections.abc import Sequence

import geopandas
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from services.access.ellipsoid import to_geodetic
from services.access.horizon import Horizon
from services.access.prediction import Access
from services.access.satellite import SatelliteAccess, Seen
from services.access.specular.tracks import PairCounts, SpecularTrack


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

    def part(self, satellite: str, seen: Seen) -> pd.DataFrame:
        """The rows of the next receiver."""
        new_image = np.diff(seen.time_index, prepend=-1) != 0
        image = self.images - 1 + np.cumsum(new_image)
        self.images += int(new_image.sum())
        return self._frame(satellite, seen, image)

    def empty(self) -> pd.DataFrame:
        """The columns without rows."""
        none = np.zeros(0)
        seen = Seen(
            none.astype(np.int32), none.astype(np.int32), none.astype(np.int16), none, none, none,
            none.astype(np.float32), none.astype(np.bool_), none.astype(np.bool_), none,
        )  # fmt: skip
        return self._frame("", seen, none)

    def _frame(self, satellite: str, seen: Seen, image: NDArray[np.int64]) -> pd.DataFrame:
        count = len(seen.row)
        return pd.DataFrame(
            {
                "image_id": image.astype(np.int32),
                "satellite": pd.Categorical.from_codes(np.zeros(count, dtype=np.int8), [satellite]),
                "time": self._horizon.times(seen.time_index),
                "target_id": self._place_id[seen.row],
                "transmitter": pd.Categorical.from_codes(seen.transmitter, self._codes),
                "incidence_deg": seen.incidence_deg,
                "distance_km": seen.distance_km,
                "rx_gain_dbi": seen.rx_gain_dbi,
                "covered_ahead": _known(seen.ahead, count),
                "covered_behind": _known(seen.behind, count),
                "along_track_error_km": np.full(count, np.nan) if seen.error_km is None else seen.error_km,
            }
        )


def _known(flags: NDArray[np.bool_] | None, count: int) -> pd.Series:
    if flags is None:
        return pd.Series(pd.NA, index=range(count), dtype="boolean")
    return pd.Series(flags)


def opportunities_frame(access: Access, target_id: NDArray[np.int64]) -> pd.DataFrame:
    """The opportunities of all receivers at once."""
    parts = OpportunityParts(access, target_id)
    frames = [parts.part(found.satellite, found.targets) for found in access.satellites if found.targets is not None]
    frame = pd.concat([parts.empty(), *frames], ignore_index=True) if frames else parts.empty()
    return frame.astype({"satellite": object, "transmitter": object})


def specular_points_part(access: Access, found: SatelliteAccess) -> geopandas.GeoDataFrame:
    """The specular track of one receiver (contract ``specular_points``) with ``nominal``: one of the channels of
    highest gain, and ``in_beam``: gain above the antennas' floor."""
    assert found.track is not None
    return _points(access, found.track)


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
    parts = [specular_points_part(access, found) for found in access.satellites if found.track is not None]
    frame = pd.concat(parts, ignore_index=True).astype({"satellite": object, "transmitter": object})
    return geopandas.GeoDataFrame(frame, geometry="geometry", crs="EPSG:4326")


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
