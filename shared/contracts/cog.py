"""Cloud-Optimised GeoTIFF: grids that web maps and GIS read by range, the same bytes for the same data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from shared.errors import ContractError

_TYPES = ("uint8", "uint16", "int16", "int32", "float32")


def write_cog(
    path: str | Path,
    bands: Mapping[str, np.ndarray],
    *,
    transform: Affine,
    crs: str,
    nodata: float | None,
    attributes: Mapping[str, Any],
    colormap: Mapping[int, tuple[int, int, int]] | None = None,
    overviews: Literal["nearest", "average", "mode"] = "nearest",
) -> None:
    """Write named bands of one shape (rows from north to south) and one type as a COG with internal overviews.

    ``transform`` is the affine map from (column, row) of a cell's corner to ``crs``; ``attributes`` become tags, each
    band's name its description; a ``colormap`` (value to red, green, blue) holds for a single uint8 band.
    Codes and classes keep ``overviews="nearest"`` (or "mode"): an average of codes is no code.
    ContractError: no band, shapes or types that differ, or a type that COG readers do not share.
    """
    stack = _checked(bands)
    count, height, width = stack.shape
    profile = {"driver": "GTiff", "count": count, "height": height, "width": width, "dtype": stack.dtype.name}
    with MemoryFile() as memory:
        with memory.open(crs=crs, transform=transform, nodata=nodata, **profile) as draft:
            draft.write(stack)
            for index, name in enumerate(bands, start=1):
                draft.set_band_description(index, name)
            if colormap:
                draft.write_colormap(1, {value: (*colour, 255) for value, colour in colormap.items()})
            draft.update_tags(**{name: _text(attributes[name]) for name in sorted(attributes)})
        with memory.open() as source:
            rasterio.shutil.copy(
                source,
                str(path),
                driver="COG",
                compress="DEFLATE",
                predictor="YES",
                blocksize=512,
                overview_resampling=overviews,
            )


def read_cog(path: str | Path) -> tuple[dict[str, np.ndarray], Affine, str, dict[str, str]]:
    """Bands by name, transform, CRS and tags of a GeoTIFF; ContractError if it is none."""
    try:
        with rasterio.open(path) as source:
            names = [name or f"band {index}" for index, name in enumerate(source.descriptions, start=1)]
            bands = dict(zip(names, source.read(), strict=True))
            return bands, source.transform, str(source.crs), dict(source.tags())
    except rasterio.errors.RasterioIOError as error:
        name = Path(path).name
        raise ContractError(f"'{name}' cannot be read as GeoTIFF: {error}", field=name) from error


def _checked(bands: Mapping[str, np.ndarray]) -> np.ndarray:
    """The bands as one array [band, row, column]."""
    kinds = {(band.shape, band.dtype.name) for band in bands.values()}
    if len(kinds) != 1 or any(len(shape) != 2 for shape, _ in kinds):
        found = "; ".join(f"{name} {band.shape} {band.dtype.name}" for name, band in bands.items()) or "none"
        raise ContractError(
            "A GeoTIFF needs bands of one shape (rows, columns) and one type.", field="bands", value=found
        )
    kind = next(iter(bands.values())).dtype.name
    if kind not in _TYPES:
        raise ContractError("This type has no GeoTIFF band.", field="bands", value=kind, accepted=", ".join(_TYPES))
    return np.stack(list(bands.values()))


def _text(value: Any) -> str:
    return ("true" if value else "false") if isinstance(value, bool | np.bool_) else str(value)
