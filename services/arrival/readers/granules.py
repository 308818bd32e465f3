"""Level-2 active-fire granules as looks: VNP14IMG, VJ114IMG and their 750 m siblings (netCDF), MOD14 and MYD14 (HDF4).

Mask codes after the products' own legends and user guides (Schroeder & Giglio, VIIRS Collection 1/2; Giglio et al.,
MODIS Collection 6.1).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from services.arrival.readers.scanners import MODIS, VIIRS_I, VIIRS_M, Scanner
from services.arrival.readers.swath import Swath, degrees_of, fit_swath
from shared.errors import DomainError

FIRE, NO_FIRE, CLOUD, WATER, GLINT, UNKNOWN = "fire", "no fire", "cloud", "water", "glint", "unknown"
# The imagery product tells the trimmed bow-tie (1) and glint (2) apart, the older format has neither; classes 7 to 9
# are fires, which the list of fire pixels gives with their places.
IMAGERY_CLASSES = {2: GLINT, 3: WATER, 4: CLOUD, 5: NO_FIRE}
OLDER_CLASSES = {3: WATER, 4: CLOUD, 5: NO_FIRE}
# The imagery product has three classes of confidence; a threshold of 70 is meant to drop the low one and keep nominal
# detections, which are most of those at night.
CONFIDENCE = {7: 20.0, 8: 75.0, 9: 95.0}
SATELLITES = {
    "NPP": "SUOMI NPP",
    "J1": "NOAA 20",
    "JPSS-1": "NOAA 20",
    "J2": "NOAA 21",
    "JPSS-2": "NOAA 21",
    "Terra": "TERRA",
    "Aqua": "AQUA",
}
LATENCY = pd.Timedelta(hours=6)
ACCEPTED = "VNP14IMG, VJ114IMG or VJ214IMG netCDF, or MOD14 or MYD14 HDF4"
COARSE = 16
Area = tuple[float, float, float, float]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Granule:
    """A granule as its file gives it: `mask` (lines, samples) of class codes, and the fire pixels (n,)."""

    name: str
    satellite: str
    scanner: Scanner
    start: pd.Timestamp
    end: pd.Timestamp
    mask: NDArray[np.uint8]
    classes: dict[int, str]
    line: Floats
    sample: Floats
    longitude: Floats
    latitude: Floats
    confidence: Floats
    frp_mw: Floats
    corners: tuple[Floats, Floats] | None

    @property
    def middle(self) -> pd.Timestamp:
        return (self.start + (self.end - self.start) / 2).floor("ms")

    def swath(self) -> Swath | None:
        """Its geometry, fitted to the fire pixels; None where those do not fix it."""
        known = (self.line, self.sample, self.longitude, self.latitude)
        return fit_swath(self.scanner, self.mask.shape[0], known, self.corners)


def within_area(longitude: Floats, latitude: Floats, area: Area, pad_deg: float = 0.0) -> NDArray[np.bool_]:
    """Positions (n,) inside (lon_min, lat_min, lon_max, lat_max), degrees, widened by a pad of degrees of latitude;
    lon_min > lon_max spans the antimeridian."""
    west, south, east, north = area
    pad = pad_deg / max(float(np.cos(np.radians((south + north) / 2))), 0.05)
    span = min(((east - west) % 360.0 or (360.0 if east != west else 0.0)) + 2 * pad, 360.0)
    return (((longitude - west + pad) % 360.0) <= span) & (latitude >= south - pad_deg) & (latitude <= north + pad_deg)


def _numbers(text: str) -> Floats:
    return np.array([float(value) for value in re.findall(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?", text)])


def _corners(longitude: str, latitude: str) -> tuple[Floats, Floats] | None:
    lon, lat = _numbers(longitude), _numbers(latitude)
    return (lon, lat) if lon.size == lat.size == 4 else None


def _scanner(name: str, shape: tuple[int, ...]) -> Scanner:
    scanner = {VIIRS_I.samples: VIIRS_I, VIIRS_M.samples: VIIRS_M, MODIS.samples: MODIS}.get(shape[-1])
    if scanner is None or len(shape) != 2:
        raise DomainError(
            f"'{name}' has a fire mask of shape {shape}, which is no scanner's known here",
            field="path",
            value=name,
            accepted="6400 (VIIRS imagery), 3200 (VIIRS moderate) or 1354 (MODIS) samples a line",
        )
    return scanner


def _assemble(name: str, read: Any, attributes: dict[str, str], satellite: str, times: Sequence[str]) -> Granule:
    """A granule from a reader of named arrays; `attributes` holds the corners' texts where the file states them."""
    mask = np.asarray(read("fire mask"), np.uint8)
    scanner = _scanner(name, mask.shape)
    parts = ("line", "sample", "longitude", "latitude", "confidence", "power")
    line, sample, lon, lat, stated, power = (np.asarray(read(f"FP_{part}"), float) for part in parts)
    imagery = scanner is VIIRS_I
    confidence = np.array([CONFIDENCE.get(int(value), np.nan) for value in stated]) if imagery else stated
    classes = IMAGERY_CLASSES if imagery else OLDER_CLASSES
    start, end = pd.to_datetime(list(times), utc=True)
    corners = _corners(attributes.get("longitude", ""), attributes.get("latitude", ""))
    label = SATELLITES.get(satellite, satellite)
    return Granule(name, label, scanner, start, end, mask, classes, line, sample, lon, lat, confidence, power, corners)


def _netcdf(path: Path) -> Granule:
    import netCDF4

    with netCDF4.Dataset(str(path)) as opened:
        opened.set_auto_mask(False)
        ring = {
            axis: str(getattr(opened, f"GRingPoint{axis.title()}", "")).replace("[", " ")
            for axis in ("longitude", "latitude")
        }

        def read(variable: str) -> NDArray[np.generic]:
            # A granule without fire leaves its fire-pixel lists out.
            if variable.startswith("FP_") and variable not in opened.variables:
                return np.zeros(0)
            return np.asarray(opened[variable][:])

        times = (str(opened.StartTime), str(opened.EndTime))
        return _assemble(path.name, read, ring, str(opened.Satellite), times)


def _metadata_value(text: str, name: str) -> str:
    found = re.search(rf"OBJECT\s*=\s*{name}\b.*?VALUE\s*=\s*(\(.*?\)|\"[^\"]*\"|\S+)", text, re.DOTALL)
    return found.group(1).strip('"') if found else ""


def _hdf4(path: Path) -> Granule:
    from pyhdf.error import HDF4Error
    from pyhdf.SD import SD, SDC

    try:
        opened = SD(str(path), SDC.READ)
        held = opened.datasets()
        attributes = opened.attributes()
        core = "".join(str(attributes[key]) for key in sorted(attributes) if key.startswith("CoreMetadata"))

        def read(variable: str) -> NDArray[np.generic]:
            if variable.startswith("FP_") and variable not in held:
                return np.zeros(0)
            return np.asarray(opened.select(variable).get())

        times = [
            f"{_metadata_value(core, f'RANGE{edge}DATE')}T{_metadata_value(core, f'RANGE{edge}TIME')}Z"
            for edge in ("BEGINNING", "ENDING")
        ]
        ring = {axis: _metadata_value(core, f"GRINGPOINT{axis.upper()}") for axis in ("longitude", "latitude")}
        return _assemble(path.name, read, ring, str(attributes["Satellite"]), times)
    except HDF4Error as error:
        raise OSError(str(error)) from error


def open_granule(path: str | Path, name: str | None = None) -> Granule:
    """Read a granule of either format. Raises DomainError for a file that is none, naming it."""
    path = Path(path)
    label = name or path.name
    try:
        with path.open("rb") as handle:
            hdf4 = handle.read(4) == b"\x0e\x03\x13\x01"
        return _hdf4(path) if hdf4 else _netcdf(path)
    except (OSError, IndexError, AttributeError, KeyError, ValueError) as error:
        message = f"'{label}' is no active-fire granule: {error}"
        raise DomainError(message, field="path", value=label, accepted=ACCEPTED) from error


def _rows(granule: Granule, lon: Floats, lat: Floats, sample: Floats, look: NDArray[np.object_] | str) -> pd.DataFrame:
    along, across = granule.scanner.footprint_m(sample)
    return pd.DataFrame(
        {
            "longitude": lon,
            "latitude": lat,
            "along_m": along,
            "across_m": across,
            "look": look,
            "confidence": np.nan,
            "frp_mw": np.nan,
        }
    )


def _others(granule: Granule, swath: Swath, area: Area) -> pd.DataFrame:
    """Pixels of an area that are no fire, by class, where the fit places them to within three quarters of a pixel."""
    lines, samples = granule.mask.shape
    at_line, at_sample = np.meshgrid(np.arange(0, lines, COARSE), np.arange(0, samples, COARSE), indexing="ij")
    lattice = (at_line.ravel().astype(float), at_sample.ravel().astype(float))
    near = within_area(*degrees_of(swath.positions_km(*lattice)), area, pad_deg=0.2)
    sure = np.zeros(near.size, bool)
    sure[near] = swath.sd_km(lattice[0][near], lattice[1][near]) <= 0.75 * granule.scanner.pixel_m / 1e3
    wanted = binary_dilation(sure.reshape(at_line.shape), np.ones((3, 3), bool))
    blocks = np.repeat(np.repeat(wanted, COARSE, axis=0), COARSE, axis=1)[:lines, :samples]
    line, sample = np.nonzero(blocks & np.isin(granule.mask, list(granule.classes)))
    code = granule.mask[line, sample]
    lon, lat = degrees_of(swath.positions_km(line.astype(float), sample.astype(float)))
    inside = within_area(lon, lat, area)
    names = np.array([granule.classes.get(value, UNKNOWN) for value in range(10)], dtype=object)
    return _rows(granule, lon[inside], lat[inside], sample[inside].astype(float), names[code[inside]])


def read_pixels(granule: Granule, areas: Sequence[Area]) -> tuple[gpd.GeoDataFrame, bool]:
    """Every classified pixel in any of the areas, `look` being fire, no fire, cloud, water or glint, and whether the
    granule could be placed: if not, only its fire pixels are given.

    Columns of the detections contract, with `look`. The time is the middle of the granule, delivery six hours later.
    """
    chosen = np.zeros(granule.longitude.size, bool)
    for area in areas:
        chosen |= within_area(granule.longitude, granule.latitude, area)
    fire = _rows(granule, granule.longitude[chosen], granule.latitude[chosen], granule.sample[chosen], FIRE)
    fire["confidence"], fire["frp_mw"] = granule.confidence[chosen], granule.frp_mw[chosen]
    swath = granule.swath()
    parts = [fire, *([_others(granule, swath, area) for area in areas] if swath is not None else [])]
    frame = pd.concat([part for part in parts if len(part)] or [fire], ignore_index=True)
    frame = frame.drop_duplicates(["longitude", "latitude", "look"], ignore_index=True)  # areas may overlap
    frame = frame.assign(
        time=granule.middle,
        delivered_at=granule.middle + LATENCY,
        satellite=granule.satellite,
        instrument=granule.scanner.instrument,
        fire=(frame["look"] == FIRE).to_numpy(bool),
    )
    geometry = gpd.points_from_xy(frame.pop("longitude"), frame.pop("latitude"))
    return gpd.GeoDataFrame(frame, geometry=geometry, crs="EPSG:4326"), swath is not None


def read_viirs(path: str | Path, area: Area) -> gpd.GeoDataFrame:
    """Fire pixels and clear land of a granule in an area as detections. Raises DomainError for another file."""
    pixels, _ = read_pixels(open_granule(path), [area])
    return pixels[pixels["look"].isin([FIRE, NO_FIRE])].drop(columns="look").reset_index(drop=True)
