"""Specular points over the WGS84 ellipsoid: where the path transmitter - surface - receiver is shortest.

The transmitter stands where it is at the receiver's time: the 70 to 90 ms of flight (250 m of its way, some 10 m at the
specular point) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.access.ellipsoid import SEMI_MAJOR_M, SEMI_MINOR_M
from services.access.specular.reflection import solve_all
from shared.errors import DomainError

Array = NDArray[np.float64]

_SEMI_AXES = np.array([SEMI_MAJOR_M, SEMI_MAJOR_M, SEMI_MINOR_M])


@dataclass(frozen=True)
class SpecularPoints:
    """Specular points of n pairs, Earth-fixed; NaN where ``status`` is not SOLVED.

    ``incidence_deg`` from the ellipsoid's normal to the transmitter, ``mismatch_deg`` the difference to the angle of
    reflection; ranges in metres. ``status``: SOLVED, OCCULTED (the Earth stands between), GRAZING (not
    certified: in practice only where the straight line passes within some 1 km of the surface, incidence over 89.9).
    """

    position_m: Array
    incidence_deg: Array
    mismatch_deg: Array
    rx_range_m: Array
    tx_range_m: Array
    status: NDArray[np.int8]


def specular_points(
    receiver_m: Array, transmitter_m: Array, surface_height_m: float = 0.0, start_m: Array | None = None
) -> SpecularPoints:
    """Specular points of pairs of Earth-fixed positions (n, 3) in metres, at a surface height along WGS84's normal.

    Newton's method on the length of the path over the surface, in the tangent plane, second derivatives with the
    surface's curvature, from ``start_m`` (n, 3) or from under the straight line. A point is SOLVED only if both
    satellites stand above its horizon and the angles of incidence and reflection agree within 1e-6 degrees. Raises
    DomainError for a position on or under the surface.
    """
    receiver, transmitter = (
        np.ascontiguousarray(x, dtype=np.float64).reshape(-1, 3) for x in (receiver_m, transmitter_m)
    )
    for name, position in (("receiver", receiver), ("transmitter", transmitter)):
        inside = ~((position**2 / (_SEMI_AXES + surface_height_m) ** 2).sum(axis=1) > 1.0)
        if inside.any():
            row = int(np.flatnonzero(inside)[0])
            raise DomainError(
                f"The {name} of row {row} is not above the surface: {position[row].tolist()} m.",
                field=name,
                value=position[row].tolist(),
                accepted="Earth-fixed positions in metres above the surface",
            )
    table = np.full((len(receiver), 8), np.nan)
    start = np.empty((0, 3)) if start_m is None else np.ascontiguousarray(start_m, dtype=np.float64)
    solve_all(receiver, transmitter, start, surface_height_m, table)
    return SpecularPoints(
        table[:, 0:3],
        np.degrees(table[:, 3]),
        np.degrees(table[:, 4]),
        table[:, 5],
        table[:, 6],
        table[:, 7].astype(np.int8),
    )
