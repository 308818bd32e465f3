"""Weather of one time with pressure levels, read from GRIB2; what is missing is named, what is impossible refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from services.prioritization.physical_ranges import physical
from shared.errors import DomainError

Array = npt.NDArray[np.float64]

ZERO_C = 273.15
LEVELS_HPA = (1000, 950, 900, 850, 800, 750, 700, 500)
SURFACE = {
    ("2t", 2): "temperature_k",
    ("2r", 2): "relative_humidity_pct",
    ("10u", 10): "wind_u_m_s",
    ("10v", 10): "wind_v_m_s",
    ("orog", 0): "elevation_m",
}
ALOFT = {"t": "temperature_k", "r": "relative_humidity_pct", "u": "wind_u_m_s", "v": "wind_v_m_s", "gh": "height_m"}


@dataclass(frozen=True)
class UpperAir:
    """Fields (y, x) of one time: ``surface`` by name, ``levels`` by pressure in hPa and name; NaN where missing.

    Names: temperature_c, relative_humidity_pct, wind_speed_m_s; surface also elevation_m, levels height_m (geopotential
    height above sea level).
    """

    time: np.datetime64
    latitude_deg: Array
    longitude_deg: Array
    surface: Mapping[str, Array]
    levels: Mapping[int, Mapping[str, Array]]

    def level(self, pressure_hpa: int, name: str) -> Array:
        """A field of a level; DomainError naming the level and field where the file had none."""
        try:
            return self.levels[pressure_hpa][name]
        except KeyError:
            there = ", ".join(str(p) for p in sorted(self.levels) if name in self.levels[p]) or "none"
            raise DomainError(
                f"The weather lacks '{name}' at {pressure_hpa} hPa; it has it at {there}.",
                field=f"{name} at {pressure_hpa} hPa",
                value=there,
                accepted="the levels of the Haines index: 950, 850, 700 and 500 hPa",
            ) from None


def read_grib(path: Path) -> UpperAir:
    """The surface and levels of the first time in a GRIB file (eccodes); DomainError if it is none or lacks the ground.

    Kelvin becomes degrees Celsius; values that cannot be are refused by name (see ``physical_ranges``).
    """
    time, shape, places, raw = _messages(path)
    surface = {ours: raw[key] for key, ours in SURFACE.items() if key in raw}
    missing = [f"{short} at {level} m" for (short, level), ours in SURFACE.items() if ours not in surface]
    if missing:
        raise DomainError(
            f"The weather lacks {missing[0]} above ground.",
            field=missing[0],
            accepted="2 m temperature and humidity, 10 m wind, orography",
        )
    levels: dict[int, dict[str, Array]] = {}
    for (short, level), values in raw.items():
        if short in ALOFT and level >= 100:
            levels.setdefault(level, {})[ALOFT[short]] = values
    named = {pressure: _units(fields, shape) for pressure, fields in levels.items()}
    return UpperAir(time, places[0].reshape(shape), places[1].reshape(shape), _units(surface, shape), named)


def _units(fields: dict[str, Array], shape: tuple[int, int]) -> dict[str, Array]:
    out: dict[str, Array] = {}
    if "temperature_k" in fields:
        out["temperature_c"] = physical(fields["temperature_k"] - ZERO_C, "temperature_c")
    if "relative_humidity_pct" in fields:
        out["relative_humidity_pct"] = physical(fields["relative_humidity_pct"], "relative_humidity_pct")
    if {"wind_u_m_s", "wind_v_m_s"} <= set(fields):
        out["wind_speed_m_s"] = physical(np.hypot(fields["wind_u_m_s"], fields["wind_v_m_s"]), "wind_speed_m_s")
    out |= {name: fields[name] for name in ("height_m", "elevation_m") if name in fields}
    return {name: values.reshape(shape) for name, values in out.items()}


def _messages(
    path: Path,
) -> tuple[np.datetime64, tuple[int, int], tuple[Array, Array], dict[tuple[str, int], Array]]:
    import eccodes

    refused = DomainError(
        "The weather is no GRIB file with fields of one grid.", field="weather", accepted="GRIB2 with pressure levels"
    )
    fields: dict[tuple[str, int], Array] = {}
    frame: tuple[np.datetime64, tuple[int, int], tuple[Array, Array]] | None = None
    eccodes.codes_grib_multi_support_on()  # NCEP packs u and v into one message
    try:
        with path.open("rb") as stream:
            while (handle := eccodes.codes_grib_new_from_file(stream)) is not None:
                try:
                    frame = frame or _frame(eccodes, handle)
                    _take(eccodes, handle, fields, frame[1])
                finally:
                    eccodes.codes_release(handle)
    except eccodes.CodesInternalError as error:
        raise refused from error
    finally:
        eccodes.codes_grib_multi_support_off()
    if frame is None:
        raise refused
    return *frame, fields


def _frame(eccodes: Any, handle: Any) -> tuple[np.datetime64, tuple[int, int], tuple[Array, Array]]:
    date, clock = (eccodes.codes_get(handle, name) for name in ("validityDate", "validityTime"))
    text = f"{date // 10000:04d}-{date // 100 % 100:02d}-{date % 100:02d}T{clock // 100:02d}:{clock % 100:02d}"
    shape = (eccodes.codes_get(handle, "Ny"), eccodes.codes_get(handle, "Nx"))
    longitude = eccodes.codes_get_array(handle, "longitudes")
    places = (eccodes.codes_get_array(handle, "latitudes"), (longitude + 180) % 360 - 180)
    return np.datetime64(text, "ns"), shape, places


def _take(eccodes: Any, handle: Any, fields: dict[tuple[str, int], Array], shape: tuple[int, int]) -> None:
    kind = eccodes.codes_get(handle, "typeOfLevel")
    if kind not in ("isobaricInhPa", "heightAboveGround", "surface"):
        return
    key = (eccodes.codes_get(handle, "shortName"), eccodes.codes_get(handle, "level"))
    wanted = key in SURFACE if kind != "isobaricInhPa" else key[0] in ALOFT and key[1] in LEVELS_HPA
    if not wanted or key in fields:
        return
    eccodes.codes_set(handle, "missingValue", 9.999e20)
    values = eccodes.codes_get_values(handle).astype(np.float64)
    if values.size != shape[0] * shape[1]:
        return
    fields[key] = np.where(values > 9e20, np.nan, values)
