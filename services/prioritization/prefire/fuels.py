"""Vegetation of the danger grid, checked cell by cell: what is impossible is flagged or refused, never rated as safe.

A variable whose values are impossible in more than one burnable cell of a hundred is refused by name: then its unit,
its scale or its order is wrong. Fewer such cells become unknown and say so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from services.prioritization import longitudes
from services.prioritization.prefire import danger_grid, fire_potential
from shared.errors import DomainError

Array = npt.NDArray[np.floating[Any]]
Flags = npt.NDArray[np.uint8]

REQUIRED = ("ndvi", "ndvi_min", "ndvi_max", "live_load", "dead_load", "extinction_pct")
OPTIONAL = ("soil_moisture_q05", "soil_moisture_q95")
NOTES = ("ndvi_date", "ndvi_years", "soil_moisture_years", "state_time")
REFUSED_SHARE = 0.01
VEGETATION_MISSING, VEGETATION_IMPOSSIBLE = 1, 2
LARGEST_LOAD = 60.0
OUTSIDE = 249


@dataclass(frozen=True)
class Fuels:
    """Vegetation fields (y, x) on a grid; ``flag`` says per cell why its vegetation is unknown (bits of this module).

    ``greenness`` 0..1, loads in kg/m2, ``extinction_pct`` the dead fuel's moisture of extinction, ``ndvi_largest`` the
    largest NDVI of the whole area (one value, so that a part of the grid is rated as in the whole).
    """

    grid: danger_grid.DangerGrid
    greenness: Array
    ndvi_max: Array
    live_load: Array
    dead_load: Array
    extinction_pct: Array
    mask_code: npt.NDArray[np.uint8]
    soil_moisture_q05: Array
    soil_moisture_q95: Array
    flag: Flags
    ndvi_largest: float
    counts: Mapping[str, int] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)

    def fields(self, take: Callable[[Array], Array]) -> dict[str, Any]:
        """Every field after ``take``."""
        names = ("greenness", "ndvi_max", "live_load", "dead_load", "extinction_pct", "mask_code", *OPTIONAL, "flag")
        return {name: take(getattr(self, name)) for name in names}

    def rows(self, rows: slice) -> Fuels:
        """The fields of some rows (the grid stays that of the whole)."""
        return replace(self, **self.fields(lambda values: values[rows]))


@dataclass(frozen=True)
class SampledFuels:
    """Fuels of a latitude-longitude grid seen on another grid: each cell takes the fuels cell that holds its centre.

    Nearest and not blended, so that codes stay codes and values stay with their mask. Cells off the fuels grid carry
    the code 249 (outside).
    """

    source: Fuels
    grid: danger_grid.UsgsGrid

    @property
    def ndvi_largest(self) -> float:
        return self.source.ndvi_largest

    @property
    def counts(self) -> Mapping[str, int]:
        return self.source.counts

    @property
    def notes(self) -> Mapping[str, str]:
        return self.source.notes

    def rows(self, rows: slice) -> Fuels:
        """The fields sampled at some rows of the grid."""
        given = self.source.grid
        assert isinstance(given, danger_grid.GeographicGrid)
        longitude, latitude = self.grid.places(rows)
        row, row_inside = _cell(latitude, given.latitude_deg, given.steps_deg[0])
        column, column_inside = _cell(longitude, given.longitude_deg, given.steps_deg[1])
        flat, inside = row * given.shape[1] + column, row_inside & column_inside
        sampled = self.source.fields(lambda values: values.ravel().take(flat))
        sampled["mask_code"] = np.where(inside, sampled["mask_code"], np.uint8(OUTSIDE))
        sampled["flag"] = np.where(inside, sampled["flag"], np.uint8(0))
        return replace(self.source, grid=self.grid, **sampled)


def _cell(place_deg: Array, axis: Array, step: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    index = np.floor((place_deg - float(axis[0])) / step + 0.5).astype(np.int64)
    return np.clip(index, 0, len(axis) - 1), (index >= 0) & (index < len(axis))


def single_precision(fuels: Fuels) -> Fuels:
    """The same fuels with fields of four bytes: enough for an index of 0-247, and half the memory."""
    return replace(
        fuels,
        **fuels.fields(lambda values: values.astype(np.float32) if values.dtype.kind == "f" else values),
    )


def fuels_from_dataset(dataset: xr.Dataset) -> Fuels:
    """Checked fuels of the contract's grid, or of one with (y, x) in metres on the USGS grid.

    DomainError naming the variable that is missing, in a wrong scale, swapped or unaligned.
    """
    missing = [name for name in (*REQUIRED, "mask_code") if name not in dataset.variables]
    if missing:
        raise DomainError(
            f"The fuels grid lacks '{missing[0]}'.", field=missing[0], accepted=", ".join((*REQUIRED, "mask_code"))
        )
    dataset = longitudes.signed(dataset)
    names = [name for name in (*REQUIRED, "mask_code", *OPTIONAL) if name in dataset.variables]
    _check_dimensions(dataset, names)
    if "latitude" in dataset["ndvi"].dims:
        ordered = dataset.sortby(["latitude", "longitude"]).transpose("latitude", "longitude", ...)
        axes = (ordered[name].to_numpy().astype(np.float64) for name in ("latitude", "longitude"))
        grid: danger_grid.DangerGrid = danger_grid.geographic_grid(*axes)
    else:
        ordered = dataset.sortby("y", ascending=False).sortby("x").transpose("y", "x", ...)
        crs = ordered["crs"].attrs.get("crs_wkt", "") if "crs" in ordered.variables else ""
        x_m, y_m = (ordered[name].to_numpy().astype(np.float64) for name in ("x", "y"))
        grid = danger_grid.aligned_usgs_window(x_m, y_m, str(crs))
    notes = {name: str(ordered.attrs[name]) for name in NOTES if name in ordered.attrs}
    return checked_fuels(grid, {name: ordered[name].to_numpy() for name in names}, notes)


def _check_dimensions(dataset: xr.Dataset, names: list[str]) -> None:
    axes = ("latitude", "longitude") if "latitude" in dataset["ndvi"].dims else ("y", "x")
    for name in names:
        if set(dataset[name].dims) != set(axes) or not set(axes) <= set(dataset.variables):
            raise DomainError(
                f"'{name}' of the fuels grid lies on {tuple(map(str, dataset[name].dims))}.",
                field=name,
                value=str(dataset[name].dims),
                accepted="latitude, longitude in degrees, or y, x in metres, with their coordinates",
            )


def checked_fuels(grid: danger_grid.DangerGrid, bands: Mapping[str, Array], notes: Mapping[str, str]) -> Fuels:
    """Fuels from fields by name (y, x), impossible cells flagged and unknown; DomainError where a whole field is."""
    mask = fire_potential.checked_mask(bands["mask_code"])
    burnable = mask < 248
    kind = np.float32 if grid.kind == "usgs-1km" else np.float64
    values = {name: np.asarray(bands[name], dtype=kind) for name in (*REQUIRED, *OPTIONAL) if name in bands}
    flag, counts = _flagged(values, burnable)
    largest = np.where(burnable & (flag == 0), values["ndvi_max"], -np.inf).max(initial=-np.inf)
    greenness = fire_potential.relative_greenness(values["ndvi"], values["ndvi_min"], values["ndvi_max"])
    greenness[flag > 0] = np.nan
    unknown = np.full(mask.shape, np.nan, dtype=kind) if OPTIONAL[0] not in values else None
    wet = {name: values.get(name, unknown) for name in OPTIONAL}
    _check_soil_moisture(wet, burnable)
    return Fuels(
        grid=grid,
        greenness=greenness,
        mask_code=mask,
        flag=flag,
        ndvi_largest=float(largest) if np.isfinite(largest) and largest > 0 else 1.0,
        counts=counts,
        notes=dict(notes),
        **{name: values[name] for name in ("ndvi_max", "live_load", "dead_load", "extinction_pct")},
        **wet,
    )


def _flagged(values: Mapping[str, Array], burnable: npt.NDArray[np.bool_]) -> tuple[Flags, dict[str, int]]:
    """Why each cell's vegetation is unknown, and how many cells broke which rule."""
    flag = np.zeros(burnable.shape, dtype=np.uint8)
    for name in REQUIRED:
        if burnable.any() and not np.isfinite(values[name][burnable]).any():
            raise DomainError(f"Every value of '{name}' is missing.", field=name, accepted="values in burnable cells")
        flag[burnable & ~np.isfinite(values[name])] |= VEGETATION_MISSING
    counts = {"vegetation missing": int((flag > 0).sum())}
    for name, rule, broken in _impossible(values):
        bad = broken & burnable
        _refuse_if_many(name, rule, values[name], bad, int(burnable.sum()))
        flag[bad] |= VEGETATION_IMPOSSIBLE
        if bad.any():
            counts[f"{name}: not {rule}"] = int(bad.sum())
    return flag, counts


def _impossible(values: Mapping[str, Array]) -> list[tuple[str, str, npt.NDArray[np.bool_]]]:
    """Each rule of the vegetation: the field it is about, what holds there, and where it is broken."""
    rules = [(name, "-1..1", np.abs(values[name]) > 1) for name in ("ndvi", "ndvi_min", "ndvi_max")]
    in_scale = ~(rules[1][2] | rules[2][2])
    rules.append(("ndvi_min", "below ndvi_max", in_scale & (values["ndvi_min"] >= values["ndvi_max"])))
    for name in ("live_load", "dead_load"):
        rules.append((name, f"0..{LARGEST_LOAD:g} kg/m2", (values[name] < 0) | (values[name] > LARGEST_LOAD)))
    extinction = values["extinction_pct"]
    rules.append(("extinction_pct", "above 2 and at most 100 %", (extinction <= 2) | (extinction > 100)))
    return rules


def _refuse_if_many(name: str, rule: str, values: Array, bad: npt.NDArray[np.bool_], cells: int) -> None:
    if bad.sum() <= REFUSED_SHARE * cells:
        return
    worst = float(values[bad][np.argmax(np.abs(values[bad]))])
    raise DomainError(
        f"'{name}' is not {rule} in {int(bad.sum())} of {cells} burnable cells (such as {worst:g}); its unit, scale or "
        "order is probably wrong.",
        field=name,
        value=worst,
        accepted=rule,
    )


def _check_soil_moisture(wet: Mapping[str, Any], burnable: npt.NDArray[np.bool_]) -> None:
    """The 5 and 95 % values as volume fractions, in their order; DomainError naming the first at fault."""
    low, high = (wet[name] for name in OPTIONAL)
    for name in OPTIONAL:
        _refuse_if_many(
            name, "0..1 m3/m3", wet[name], burnable & ((wet[name] < 0) | (wet[name] > 1)), int(burnable.sum())
        )
    _refuse_if_many(OPTIONAL[0], f"below {OPTIONAL[1]}", low, burnable & (low > high), int(burnable.sum()))


def read_geotiff(path: str) -> Fuels:
    """Checked fuels from a GeoTIFF on the USGS grid, its bands named as the contract's variables.

    A band's own scale and offset are applied and its no-data value is missing; ContractError or DomainError if it is
    no GeoTIFF, lacks a band or lies on another grid.
    """
    import rasterio

    from shared.errors import ContractError

    try:
        with rasterio.open(path) as source:
            known = (*REQUIRED, *OPTIONAL, "mask_code")
            places = {name: index for index, name in enumerate(source.descriptions, start=1) if name in known}
            _check_bands(places)
            stack = source.read(list(places.values()))  # at once: bands are stored cell by cell
            bands = {
                name: _band(raw, source, index) if name != "mask_code" else raw
                for raw, (name, index) in zip(stack, places.items(), strict=True)
            }
            transform, crs, tags = source.transform, source.crs, source.tags()
            height, width = source.shape
    except rasterio.errors.RasterioIOError as error:
        raise ContractError(f"The fuels cannot be read as GeoTIFF: {error}", field="fuels") from error
    x_m = transform.c + transform.a * (np.arange(width) + 0.5)
    y_m = transform.f + transform.e * (np.arange(height) + 0.5)
    grid = danger_grid.aligned_usgs_window(x_m, y_m, crs.to_wkt() if crs else "")
    return checked_fuels(grid, bands, {name: str(tags[name]) for name in NOTES if name in tags})


def _check_bands(found: Mapping[str, int]) -> None:
    missing = [name for name in (*REQUIRED, "mask_code") if name not in found]
    if missing:
        raise DomainError(
            f"The fuels GeoTIFF lacks the band '{missing[0]}'.",
            field=missing[0],
            accepted="bands described as " + ", ".join((*REQUIRED, "mask_code")),
        )


def _band(raw: Array, source: Any, index: int) -> Array:
    """A band in its units, missing as NaN."""
    values = raw.astype(np.float32, copy=False)
    scale, offset, nodata = source.scales[index - 1], source.offsets[index - 1], source.nodatavals[index - 1]
    missing = raw == nodata if nodata is not None and not np.isnan(nodata) else None
    if (scale, offset) != (1.0, 0.0):
        values = (values * np.float32(scale) + np.float32(offset)).astype(np.float32)
    if missing is not None:
        values[missing] = np.nan
    return values
