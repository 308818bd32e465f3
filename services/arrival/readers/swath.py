"""Where the pixels of a granule lie: its orbit and attitude fitted to those pixels whose places the product gives.

The active-fire products of VIIRS and MODIS state positions at fire pixels only; those of clear and cloudy pixels need
the geolocation file, which often is not at hand. The geometry of a scanner on a near-circular orbit has few unknowns
(node, argument of latitude, attitude, height), so the fire pixels of the whole granule fix it, to 0.2-0.5 km (median).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from services.arrival.readers.scanners import Scanner

# WGS 84; gravity and rotation of the Earth; the last less the drift of a sun-synchronous node.
RADIUS_KM, FLATTENING, MU_KM3_S2 = 6378.137, 1 / 298.257223563, 398600.4418
SPIN_RAD_S = 7.2921159e-5 - 1.991e-7
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
# Prior standard deviations: roll, pitch, yaw (mrad), height (km), and per 100 s: height (km), pitch (mrad). Terrain
# shifts single pixels by some hundred metres.
PRIOR_SD = np.array([1.7, 1.7, 1.7, 5.0, 3.3, 0.7])
PIXEL_SD_KM, CORNER_SD_KM, MOST_PIXELS = 0.4, 15.0, 1500
LOCAL_PIXELS, LOCAL_COUNT = 100.0, 8
Floats = NDArray[np.float64]


def earth_fixed_km(longitude_deg: Floats, latitude_deg: Floats) -> Floats:
    """Earth-fixed positions (n, 3), km, on the ellipsoid."""
    lon, lat = np.radians(longitude_deg), np.radians(latitude_deg)
    normal = RADIUS_KM / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
    planar = normal * np.cos(lat)
    return np.stack([planar * np.cos(lon), planar * np.sin(lon), normal * (1 - ECCENTRICITY2) * np.sin(lat)], axis=-1)


def degrees_of(position_km: Floats) -> tuple[Floats, Floats]:
    """Longitude and latitude in degrees of positions (n, 3) on the ellipsoid."""
    x, y, z = np.moveaxis(position_km, -1, 0)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y) * (1 - ECCENTRICITY2)))


def _frame(position_km: Floats, velocity: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit vectors down (geodetic nadir), left of flight, and forward at satellite positions (n, 3)."""
    x, y, z = np.moveaxis(position_km, -1, 0)
    planar = np.hypot(x, y)
    lat = np.arctan2(z, planar * (1 - ECCENTRICITY2))
    for _ in range(3):
        normal = RADIUS_KM / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + ECCENTRICITY2 * normal * np.sin(lat), planar)
    lon = np.arctan2(y, x)
    down = -np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    right = np.cross(down, velocity)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    return down, -right, np.cross(right, down)


def _on_ellipsoid(origin_km: Floats, direction: Floats) -> Floats:
    """Where rays (n, 3) first meet the ellipsoid; a ray that misses ends nearest to it."""
    squash = np.array([1.0, 1.0, 1.0 / (1.0 - FLATTENING)]) / RADIUS_KM
    start, along = origin_km * squash, direction * squash
    a, b = (along**2).sum(-1), (start * along).sum(-1)
    c = (start**2).sum(-1) - 1.0
    reach = (-b - np.sqrt(np.maximum(b**2 - a * c, 0.0))) / a
    return np.asarray(origin_km + reach[..., None] * direction)


def locate(state: Floats, line: Floats, sample: Floats, scanner: Scanner) -> Floats:
    """Earth-fixed positions (n, 3), km, of pixels (n,) by the state (8,): node and argument of latitude at line 0
    (degrees), roll, pitch, yaw (mrad), height above the nominal (km), and per 100 s: height (km) and pitch (mrad)."""
    node, latitude, roll, pitch, yaw, height, height_rate, pitch_rate = state
    scan = np.floor(line / scanner.lines_per_scan)
    detector = line - scan * scanner.lines_per_scan - (scanner.lines_per_scan - 1) / 2
    angle = scanner.angle_rad(sample)
    seconds = (scan + angle / (2 * np.pi)) * scanner.scan_s
    motion = np.sqrt(MU_KM3_S2 / (RADIUS_KM - 7.0 + scanner.altitude_km + height) ** 3)
    radius = RADIUS_KM - 7.0 + scanner.altitude_km + height + height_rate * seconds / 100
    u, node_rad = np.radians(latitude) + motion * seconds, np.radians(node) - SPIN_RAD_S * seconds
    cos_i, sin_i = np.cos(np.radians(scanner.inclination_deg)), np.sin(np.radians(scanner.inclination_deg))
    cu, su, co, so = np.cos(u), np.sin(u), np.cos(node_rad), np.sin(node_rad)
    outward = np.stack([co * cu - so * su * cos_i, so * cu + co * su * cos_i, su * sin_i], axis=-1)
    velocity = np.stack([-co * su - so * cu * cos_i, -so * su + co * cu * cos_i, cu * sin_i], axis=-1)
    position = np.asarray(radius)[..., None] * outward
    down, left, forward = _frame(position, velocity)
    forward, left = forward - yaw * 1e-3 * left, left + yaw * 1e-3 * forward
    ahead = detector * scanner.pixel_m / 1e3 / scanner.altitude_km + (pitch + pitch_rate * seconds / 100) * 1e-3
    aside = angle - roll * 1e-3  # samples count from right to left of the flight
    across = np.cos(aside)[..., None] * down + np.sin(aside)[..., None] * left
    direction = np.cos(ahead)[..., None] * across + np.sin(ahead)[..., None] * forward
    return _on_ellipsoid(position, direction / np.linalg.norm(direction, axis=-1, keepdims=True))


@dataclass(frozen=True)
class Swath:
    """A fitted granule: its state with covariance, and the misfits (n, 3), km, at the pixels that it rests on."""

    scanner: Scanner
    state: Floats
    covariance: Floats
    line: Floats
    sample: Floats
    misfit_km: Floats

    def positions_km(self, line: Floats, sample: Floats) -> Floats:
        """Earth-fixed positions (n, 3), km, with the median misfit of the nearest known pixels (terrain) taken off."""
        placed = locate(self.state, line, sample, self.scanner)
        if self.line.size < 3:
            return placed
        count = min(LOCAL_COUNT, self.line.size)
        tree = cKDTree(np.column_stack([self.line, self.sample]))
        distance, index = tree.query(np.column_stack([line, sample]), k=count)
        near = distance <= LOCAL_PIXELS
        nearby = np.where(near[..., None], self.misfit_km[index], np.nan)
        enough = near.sum(axis=1) >= 3
        placed[enough] -= np.nanmedian(nearby[enough], axis=1)
        return placed

    def sd_km(self, line: Floats, sample: Floats) -> Floats:
        """Standard deviation of positions (n,) from the fit's covariance, one axis, km."""
        base = locate(self.state, line, sample, self.scanner)
        steps = np.sqrt(np.diag(self.covariance))
        moved = [
            (locate(self.state + step * unit, line, sample, self.scanner) - base) / step
            for step, unit in zip(steps, np.eye(steps.size), strict=True)
        ]
        jacobian = np.stack(moved, axis=-1)  # (n, 3, 8)
        return np.sqrt(np.einsum("nij,jk,nik->n", jacobian, self.covariance, jacobian) / 2)


def _starts(scanner: Scanner, centre_km: Floats, line: float) -> list[Floats]:
    """States whose ground track passes the centre, northward and southward."""
    out = centre_km / np.linalg.norm(centre_km)
    inclination = np.radians(scanner.inclination_deg)
    rise = np.arcsin(np.clip(out[2] / np.sin(inclination), -1.0, 1.0))
    seconds = line / scanner.lines_per_scan * scanner.scan_s
    motion = np.sqrt(MU_KM3_S2 / (RADIUS_KM + scanner.altitude_km) ** 3)
    states = []
    for u in (rise, np.pi - rise):
        node = np.arctan2(out[1], out[0]) - np.arctan2(np.cos(inclination) * np.sin(u), np.cos(u))
        first = np.degrees([node + SPIN_RAD_S * seconds, u - motion * seconds])
        states.append(np.concatenate([first, np.zeros(6)]))
    return states


def fit_swath(
    scanner: Scanner, lines: int, pixels: tuple[Floats, Floats, Floats, Floats], corners: tuple[Floats, Floats] | None
) -> Swath | None:
    """Fit a granule of `lines` lines to pixels (line, sample, longitude, latitude; each (n,)) and its corners.

    `corners`: longitude and latitude (4,) around the granule in either sense, from any of them; they only break the
    tie where pixels are few. None: nothing to fit to, or no orbit that explains it.
    """
    line, sample, lon, lat = (np.asarray(values, float) for values in pixels)
    if line.size > MOST_PIXELS:
        chosen = np.linspace(0, line.size - 1, MOST_PIXELS).astype(int)
        line, sample, lon, lat = line[chosen], sample[chosen], lon[chosen], lat[chosen]
    if line.size == 0:
        return None
    known = earth_fixed_km(lon, lat)
    best: tuple[float, Floats] | None = None
    for start in _starts(scanner, known.mean(axis=0), float(line.mean())):

        def coarse(pair: Floats, begin: Floats = start) -> Floats:
            return (locate(np.concatenate([pair, begin[2:]]), line, sample, scanner) - known).ravel() / 5.0

        found = least_squares(coarse, start[:2], loss="soft_l1", max_nfev=60)
        apart = float(found.cost) + _corner_cost(np.concatenate([found.x, start[2:]]), lines, corners, scanner)
        if best is None or apart < best[0]:
            best = (apart, np.concatenate([found.x, start[2:]]))
    assert best is not None

    def residuals(state: Floats) -> Floats:
        off = (locate(state, line, sample, scanner) - known).ravel() / PIXEL_SD_KM
        return np.concatenate([off, state[2:] / PRIOR_SD])

    scale = np.array([0.1, 0.1, 1, 1, 1, 3, 1, 1])
    fitted = least_squares(residuals, best[1], x_scale=scale, max_nfev=60)
    misfit = locate(fitted.x, line, sample, scanner) - known
    if np.median(np.linalg.norm(misfit, axis=1)) > 2.5 * max(PIXEL_SD_KM, scanner.pixel_m / 1e3):
        return None
    return Swath(scanner, fitted.x, np.linalg.pinv(fitted.jac.T @ fitted.jac), line, sample, misfit)


def _corner_cost(state: Floats, lines: int, corners: tuple[Floats, Floats] | None, scanner: Scanner) -> float:
    """How far (in standard deviations, robustly) the granule's outline lies from its stated corners."""
    if corners is None:
        return 0.0
    ours = locate(
        state,
        np.array([0.0, 0.0, lines - 1.0, lines - 1.0]),
        np.array([0.0, scanner.samples - 1.0, scanner.samples - 1.0, 0.0]),
        scanner,
    )
    apart, _ = cKDTree(ours).query(earth_fixed_km(*corners))
    return float(np.log1p((apart / CORNER_SD_KM) ** 2).sum())
