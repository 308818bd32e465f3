"""Active-fire granules written in the documented format, of a made-up pass whose every pixel's place is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import netCDF4
import numpy as np

from services.arrival.readers.scanners import MODIS, VIIRS_I, VIIRS_M, Scanner
from services.arrival.readers.swath import degrees_of, locate

CODES = {"water": 3, "cloud": 4, "no fire": 5}


@dataclass(frozen=True)
class MadeUp:
    """A granule's truth: places (lines, samples) in degrees, `mask` of class codes, fire pixels (n, 2)."""

    scanner: Scanner
    longitude: np.ndarray
    latitude: np.ndarray
    mask: np.ndarray
    fires: np.ndarray
    start: str
    end: str

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        edges = ([0, 0, -1, -1], [0, -1, -1, 0])
        return self.longitude[edges], self.latitude[edges]


def made_up(scanner: Scanner, node_deg: float, latitude_arg_deg: float, lines: int, fires: int = 40) -> MadeUp:
    """A pass from a node and argument of latitude, with an attitude of its own; fires in a cluster, cloud, a lake."""
    rng = np.random.default_rng(7)
    state = np.array([node_deg, latitude_arg_deg, 0.8, -1.2, 1.5, 3.0, 1.2, -0.5])
    line, sample = np.meshgrid(np.arange(lines, dtype=float), np.arange(scanner.samples, dtype=float), indexing="ij")
    position = locate(state, line.ravel(), sample.ravel(), scanner)
    lon, lat = degrees_of(position)
    mask = np.full((lines, scanner.samples), CODES["no fire"], np.uint8)
    mask[:, : scanner.samples // 8] = CODES["cloud"]
    mask[: lines // 4, scanner.samples // 2 :] = CODES["water"]
    centre = np.array([lines * 0.6, scanner.samples * 0.4])
    spots = np.unique(np.rint(centre + rng.normal(0, [12, 20], (fires, 2))).astype(int), axis=0)
    far = np.array([[lines - 9, scanner.samples - 30], [lines // 2, scanner.samples - 60], [7, scanner.samples // 3]])
    spots = np.concatenate([spots, far]) if fires else np.zeros((0, 2), int)
    mask[spots[:, 0], spots[:, 1]] = 8
    shape = mask.shape
    times = ("2023-01-15 12:00:00.000", "2023-01-15 12:06:00.000")
    return MadeUp(scanner, lon.reshape(shape), lat.reshape(shape), mask, spots, *times)


def _fire_lists(granule: MadeUp) -> dict[str, np.ndarray]:
    row, column = granule.fires.T
    percent = granule.scanner is not VIIRS_I
    return {
        "FP_line": row.astype(np.uint16),
        "FP_sample": column.astype(np.uint16),
        "FP_longitude": granule.longitude[row, column].astype(np.float32),
        "FP_latitude": granule.latitude[row, column].astype(np.float32),
        "FP_confidence": np.full(row.size, 80 if percent else 8, np.uint8),
        "FP_power": np.full(row.size, 12.5, np.float32),
    }


def write_viirs_file(path: Path, granule: MadeUp, satellite: str = "NPP", ring: bool = True) -> Path:
    """VNP14IMG (6400 samples) or VNP14 (3200) as netCDF, with the global attributes that the product carries."""
    assert granule.scanner in (VIIRS_I, VIIRS_M)
    with netCDF4.Dataset(str(path), "w") as file:
        file.createDimension("lines", granule.mask.shape[0])
        file.createDimension("samples", granule.mask.shape[1])
        file.createVariable("fire mask", "u1", ("lines", "samples"), zlib=True)[:] = granule.mask
        if len(granule.fires):  # real granules without fire leave the lists out
            file.createDimension("fires", len(granule.fires))
            for name, values in _fire_lists(granule).items():
                file.createVariable(name, values.dtype, ("fires",))[:] = values
        file.StartTime, file.EndTime, file.Satellite = granule.start, granule.end, satellite
        if ring:
            lon, lat = granule.corners()
            file.GRingPointLongitude, file.GRingPointLatitude = str(list(lon)), str(list(lat))
    return path


def write_modis_file(path: Path, granule: MadeUp, satellite: str = "Aqua") -> Path:
    """MOD14 or MYD14 as HDF4, the time in its core metadata."""
    from pyhdf.SD import SD, SDC

    assert granule.scanner is MODIS
    kinds = {"uint8": SDC.UINT8, "uint16": SDC.UINT16, "float32": SDC.FLOAT32}
    file = SD(str(path), SDC.WRITE | SDC.CREATE)
    for name, values in {"fire mask": granule.mask, **_fire_lists(granule)}.items():
        array = file.create(name, kinds[values.dtype.name], values.shape)
        array[:] = values
        array.endaccess()
    lines = []
    for edge, moment in (("BEGINNING", granule.start), ("ENDING", granule.end)):
        for part, text in zip(("DATE", "TIME"), moment.split(), strict=True):
            lines.append(
                f'OBJECT = RANGE{edge}{part}\n NUM_VAL = 1\n VALUE = "{text}"\nEND_OBJECT = RANGE{edge}{part}\n'
            )
    for axis, values in zip(("LONGITUDE", "LATITUDE"), granule.corners(), strict=True):
        lines.append(f'OBJECT = GRINGPOINT{axis}\n CLASS = "1"\n VALUE = {tuple(map(float, values))}\nEND_OBJECT\n')
    file.attr("CoreMetadata.0").set(SDC.CHAR, "".join(lines))
    file.attr("Satellite").set(SDC.CHAR, satellite)
    file.end()
    return path
