"""Fire perimeters to draw under looks, from GeoParquet or GeoJSON."""

from __future__ import annotations

from pathlib import Path

import geopandas
import pyarrow as pa

from shared.errors import DomainError


def read_perimeters(path: Path) -> geopandas.GeoDataFrame:
    """Areas in EPSG:4326; DomainError where the file holds none."""
    try:
        with open(path, "rb") as file:
            parquet = file.read(4) == b"PAR1"
        frame = geopandas.read_parquet(path) if parquet else geopandas.read_file(path)
    except (OSError, ValueError, RuntimeError, pa.ArrowInvalid) as error:
        raise DomainError(
            f"The perimeters cannot be read: {error}",
            field="perimeters",
            value=path.name,
            accepted="GeoParquet, GeoJSON",
        ) from error
    located = frame.set_crs("EPSG:4326") if frame.crs is None else frame.to_crs("EPSG:4326")
    return located[located.geom_type.isin(["Polygon", "MultiPolygon"])]
