"""Arrival on the fire subgrid of a WRF-SFIRE domain: the variable `TIGN_G` as netCDF, for `wrfinput` to take over.

WRF's Lambert conformal grid on a sphere of 6370 km (Skamarock et al. 2008, section 3); the fire mesh divides every
cell of the atmosphere into `sr_x` by `sr_y`, and its last `sr` rows and columns are padding (wrfxpy strips them).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from scipy.ndimage import distance_transform_edt, map_coordinates

from services.arrival.grid import project
from services.arrival.inference import ArrivalMap
from shared.errors import DomainError

WRF_RADIUS_M = 6_370_000.0
LAMBERT = 1
# Unburned: past this many seconds and past the simulation's end (the default of wrfxpy's `outside_time`).
OUTSIDE_S = 360_000.0
COPIED = ("MAP_PROJ", "TRUELAT1", "TRUELAT2", "STAND_LON", "MOAD_CEN_LAT", "CEN_LAT", "CEN_LON", "DX", "DY")
ACCEPTED = (
    "a wrfinput-like netCDF: XLAT and XLONG, attributes MAP_PROJ=1, TRUELAT1, TRUELAT2, STAND_LON, MOAD_CEN_LAT or "
    "CEN_LAT, DX, DY, and the dimensions south_north_subgrid and west_east_subgrid"
)
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FireSubgrid:
    """A fire mesh: Lambert attributes, `rows` and `columns` with padding, `ratio` (sr_y, sr_x), cell size in m, and
    the projected position (x, y) of the outer corner of the first fire cell, m."""

    attributes: dict[str, float]
    rows: int
    columns: int
    ratio: tuple[int, int]
    cell_m: tuple[float, float]
    corner_m: tuple[float, float]

    @property
    def crs(self) -> CRS:
        return lambert_crs(self.attributes)

    def degrees(self) -> tuple[Floats, Floats]:
        """Longitude and latitude (rows, columns) of the fire cells' centres, degrees (FXLONG, FXLAT)."""
        x = self.corner_m[0] + (np.arange(self.columns) + 0.5) * self.cell_m[0]
        y = self.corner_m[1] + (np.arange(self.rows) + 0.5) * self.cell_m[1]
        lon, lat = _to_degrees(self.crs, *np.meshgrid(x, y))
        return lon, lat

    def index(self, longitude_deg: Floats, latitude_deg: Floats) -> tuple[Floats, Floats]:
        """Fractional (row, column) of positions in degrees; whole numbers at cell centres."""
        inverse = Transformer.from_crs(self.crs.geodetic_crs, self.crs, always_xy=True)
        x, y = inverse.transform(longitude_deg, latitude_deg)
        column = (np.asarray(x) - self.corner_m[0]) / self.cell_m[0] - 0.5
        return (np.asarray(y) - self.corner_m[1]) / self.cell_m[1] - 0.5, column

    def padding(self) -> NDArray[np.bool_]:
        """The last `sr` rows and columns (rows, columns), which lie outside the atmosphere's grid."""
        outside = np.zeros((self.rows, self.columns), bool)
        outside[self.rows - self.ratio[0] :] = True
        outside[:, self.columns - self.ratio[1] :] = True
        return outside


def lambert_crs(attributes: Mapping[str, float]) -> CRS:
    """WRF's Lambert conformal projection; its latitudes and longitudes are on the sphere, as WRF takes them."""
    return CRS.from_proj4(
        f"+proj=lcc +lat_1={attributes['TRUELAT1']} +lat_2={attributes['TRUELAT2']} "
        f"+lat_0={attributes['MOAD_CEN_LAT']} +lon_0={attributes['STAND_LON']} "
        f"+a={WRF_RADIUS_M} +b={WRF_RADIUS_M} +units=m +no_defs"
    )


def _to_degrees(crs: CRS, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    lon, lat = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(x, y)
    return np.asarray(lon), np.asarray(lat)


def _refused(name: str, why: str) -> DomainError:
    return DomainError(f"'{name}' gives no fire subgrid: {why}", field="wrfinput", value=name, accepted=ACCEPTED)


def _first(opened: netCDF4.Dataset, name: str) -> float | None:
    """The first value of a coordinate; None where the file has no such variable."""
    return float(np.asarray(opened[name][:]).reshape(-1)[0]) if name in opened.variables else None


def read_subgrid(path: str | Path, name: str | None = None) -> FireSubgrid:
    """The fire subgrid that a wrfinput-like file describes. Raises DomainError for anything but a Lambert domain with
    a fire mesh."""
    label = name or Path(path).name
    try:
        with netCDF4.Dataset(str(path)) as opened:
            held = {key: float(opened.getncattr(key)) for key in COPIED if key in opened.ncattrs()}
            sizes = {key: len(value) for key, value in opened.dimensions.items()}
            stated = {key: _first(opened, key) for key in ("FXLAT", "FXLONG", "XLAT", "XLONG")}
    except (OSError, IndexError, KeyError, ValueError) as error:
        raise _refused(label, str(error)) from error
    if int(held.get("MAP_PROJ", 0)) != LAMBERT:
        raise _refused(label, f"MAP_PROJ is {held.get('MAP_PROJ')}, not 1 (Lambert conformal)")
    held.setdefault("MOAD_CEN_LAT", held.get("CEN_LAT", np.nan))
    lacking = [key for key in ("TRUELAT1", "TRUELAT2", "STAND_LON", "DX", "DY") if key not in held]
    dims = ("south_north", "west_east", "south_north_subgrid", "west_east_subgrid")
    lacking += [key for key in dims if key not in sizes]
    if lacking or not np.isfinite(held["MOAD_CEN_LAT"]):
        raise _refused(label, f"it lacks {', '.join(lacking) or 'MOAD_CEN_LAT'}")
    ratio = []
    for axis in ("south_north", "west_east"):
        times, rest = divmod(sizes[f"{axis}_subgrid"], sizes[axis] + 1)
        if rest or times < 1:
            raise _refused(label, f"{axis}_subgrid is {sizes[f'{axis}_subgrid']}, no multiple of {sizes[axis]} + 1")
        ratio.append(times)
    crs = lambert_crs(held)
    cell = (held["DX"] / ratio[1], held["DY"] / ratio[0])
    # The mesh's own coordinates where they are filled in (wrfinput of a run without fire holds zeros), else the grid's.
    own = bool(stated["FXLAT"] or stated["FXLONG"])
    lat, lon, size = (
        (stated["FXLAT"], stated["FXLONG"], cell)
        if own
        else (stated["XLAT"], stated["XLONG"], (held["DX"], held["DY"]))
    )
    if lat is None or lon is None:
        raise _refused(label, "it has neither FXLAT and FXLONG nor XLAT and XLONG")
    x, y = Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True).transform(lon, lat)
    corner = (float(x) - size[0] / 2, float(y) - size[1] / 2)
    rows, columns = sizes["south_north_subgrid"], sizes["west_east_subgrid"]
    return FireSubgrid(held, rows, columns, (ratio[0], ratio[1]), cell, corner)


def _carried_out(hours: Floats) -> Floats:
    """Arrival with unburned cells filled from the nearest burned one at its own upwind pace, so that interpolation at
    the edge of the fire leans on a plane and not on fewer corners."""
    burned = np.isfinite(hours)
    padded = np.pad(hours, 1, constant_values=np.nan)
    middle = padded[1:-1, 1:-1]
    along_rows = np.fmax(middle - padded[:-2, 1:-1], middle - padded[2:, 1:-1])
    along_columns = np.fmax(middle - padded[1:-1, :-2], middle - padded[1:-1, 2:])
    pace = np.hypot(*(np.nan_to_num(np.fmax(steps, 0.0)) for steps in (along_rows, along_columns)))
    distance, nearest = distance_transform_edt(~burned, return_indices=True)
    at = (nearest[0], nearest[1])
    return np.where(burned, hours, hours[at] + distance * pace[at])


def _sample(arrival: ArrivalMap, lon: Floats, lat: Floats) -> Floats:
    """Arrival hours at positions: bilinear where the nearest cell burned; NaN elsewhere."""
    grid, hours = arrival.grid, arrival.arrival_h
    if not np.isfinite(hours).any():
        return np.full(lon.shape, np.nan)
    x, y = project(grid.epsg, lon.ravel(), lat.ravel())
    column, row = (x - grid.x_m[0]) / grid.cell_m, (y - grid.y_m[0]) / grid.cell_m
    rows, columns = grid.shape
    inside = (row > -0.5) & (row < rows - 0.5) & (column > -0.5) & (column < columns - 0.5)
    row, column = np.where(inside, row, 0.0), np.where(inside, column, 0.0)
    value = map_coordinates(_carried_out(hours), [row, column], order=1, mode="nearest")
    near = np.isfinite(hours[np.rint(row).astype(int), np.rint(column).astype(int)]) & inside
    return np.asarray(np.where(near, value, np.nan).reshape(lon.shape))


def tign_g(
    fires: Sequence[tuple[ArrivalMap, pd.Timestamp]], subgrid: FireSubgrid, start: pd.Timestamp, end: pd.Timestamp
) -> tuple[Floats, float]:
    """(`TIGN_G` (rows, columns) in s since `start`, the value of unburned cells) of fires with their reference times.

    Cells that burned before the start are 0, burning as the simulation begins; cells that did not burn, or later than
    `end`, and the padding get a value past the simulation's end. Of several fires the earliest counts. Raises
    DomainError where `end` is not after `start` or no fire reaches the subgrid.
    """
    if end <= start:
        raise DomainError(
            "the simulation ends before it starts",
            field="simulation_end",
            value=str(end),
            accepted=f"a time after {start}",
        )
    lon, lat = subgrid.degrees()
    seconds = np.full(lon.shape, np.inf)
    for arrival, reference in fires:
        offset = (reference - start).total_seconds()
        own = _sample(arrival, lon, lat) * 3600.0 + offset
        seconds = np.fmin(seconds, own)
    seconds[subgrid.padding()] = np.inf
    if not np.isfinite(seconds).any():
        raise DomainError(
            "no mapped fire lies on the fire subgrid",
            field="wrfinput",
            value=f"{lat.min():.3f}..{lat.max():.3f} N, {lon.min():.3f}..{lon.max():.3f} E",
            accepted="a domain around a fire of this request",
        )
    length = (end - start).total_seconds()
    outside = max(OUTSIDE_S, length + 3600.0)
    return np.where(seconds <= length, np.maximum(np.round(seconds), 0.0), outside), outside


def write_tign_g(
    path: Path,
    values: Floats,
    subgrid: FireSubgrid,
    start: pd.Timestamp,
    outside_s: float,
    attributes: Mapping[str, Any],
) -> None:
    """Write `TIGN_G`, `FXLONG` and `FXLAT` as WRF names and orders them: float32 (Time, south_north_subgrid,
    west_east_subgrid), with the domain's projection and the value of unburned cells as attributes."""
    lon, lat = subgrid.degrees()
    with netCDF4.Dataset(str(path), "w", format="NETCDF4") as file:
        dims = ("Time", "south_north_subgrid", "west_east_subgrid")
        for name, size in zip((*dims, "DateStrLen"), (1, subgrid.rows, subgrid.columns, 19), strict=True):
            file.createDimension(name, size)
        file.createVariable("Times", "S1", ("Time", "DateStrLen"))[0] = list(start.strftime("%Y-%m-%d_%H:%M:%S"))
        fields = (
            ("TIGN_G", values, "s", "ignition time on the fire mesh, since the simulation's start"),
            ("FXLONG", lon, "degrees_east", "longitude of the fire mesh"),
            ("FXLAT", lat, "degrees_north", "latitude of the fire mesh"),
        )
        for name, data, units, description in fields:
            variable = file.createVariable(name, "f4", dims, zlib=True, complevel=4)
            variable[0] = data.astype(np.float32)
            own = {"FieldType": 104, "MemoryOrder": "XY ", "description": description, "units": units, "stagger": "Z"}
            variable.setncatts(own if name != "TIGN_G" else {**own, "coordinates": "FXLONG FXLAT"})
        held = {key: subgrid.attributes[key] for key in COPIED if key in subgrid.attributes}
        held["MAP_PROJ"] = np.int32(LAMBERT)
        extra = {"sr_y": np.int32(subgrid.ratio[0]), "sr_x": np.int32(subgrid.ratio[1])}
        extra |= {"outside_time_s": outside_s, "SIMULATION_START_DATE": start.strftime("%Y-%m-%d_%H:%M:%S")}
        stamped = {**{k: str(v) for k, v in attributes.items()}, **held, **extra}
        file.setncatts({key: stamped[key] for key in sorted(stamped)})
