"""The artifacts of a prediction, written while receivers come in one after the other and then let go."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.access import tables
from services.access.coverage.grid import CellGrid
from services.access.coverage.revisit import Revisits
from services.access.coverage.seen import Seen
from services.access.prediction import Access
from services.access.report import Tally
from services.access.satellite import SatelliteAccess
from shared.contracts.schema import Column, TableSchema, TableWriter, write_table

if TYPE_CHECKING:
    from shared.artifacts.reference import ArtifactRef
    from shared.process.context import JobContext

_STATISTICS = (
    Column("visits", "int32", minimum=0),
    Column("images", "int64", minimum=0),
    Column("first_covered", "time", nullable=True),
    Column("mean_gap_h", "float64", nullable=True, minimum=0),
    Column("median_gap_h", "float64", nullable=True, minimum=0),
    Column("max_gap_h", "float64", nullable=True, minimum=0),
    Column("longest_wait_h", "float64", minimum=0),
)
REVISIT = TableSchema("revisit", (Column("target_id", "int64"), *_STATISTICS), unique=("target_id",))
CELLS = TableSchema(
    "cells",
    (
        Column("cell_id", "int64"),
        Column("geometry", "geometry"),
        Column("row", "int32", required=False),
        Column("column", "int32", required=False),
        *_STATISTICS,
    ),
    unique=("cell_id",),
)


class Delivery:
    """Tables of one prediction: ``add`` each receiver, then ``close``; what is small is kept in ``access``.

    A context manager, so that half-written files are closed where a receiver fails.
    """

    def __init__(self, context: JobContext, access: Access, target_id: NDArray[np.int64], cell_rows: bool) -> None:
        self.access, self.tally = access, Tally()
        self.targets = Revisits(access.target_count, access.horizon) if access.target_count else None
        self.cells = None if access.grid is None else Revisits(len(access.grid), access.horizon)
        self._context, self._target_id = context, target_id
        self._stack = ExitStack()
        self._of_targets = tables.OpportunityParts(access, target_id)
        self._opportunities = self._table("opportunities.parquet", self._of_targets.empty(), "OPPORTUNITIES")
        self._points: TableWriter | None = None
        self._cell_rows: TableWriter | None = None
        if access.options.with_specular_points:
            empty = tables.no_specular_points(access)
            self._points = self._table("specular_points.parquet", empty, "SPECULAR_POINTS")
        if cell_rows and access.grid is not None:
            self._of_cells = tables.OpportunityParts(access, np.arange(len(access.grid), dtype=np.int64))
            self._cell_rows = self._table("cell_opportunities.parquet", self._of_cells.empty(), "OPPORTUNITIES")

    def __enter__(self) -> Delivery:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def add(self, found: SatelliteAccess) -> None:
        """Write one receiver's tables; its contacts and eclipses are kept."""
        if found.targets is not None and self.targets is not None:
            self.targets.add(found.targets.visits, found.targets.nearest_km)
            for part in self._of_targets.parts(found.satellite, found.targets):
                self._opportunities.write(part)
            self.tally.images = self._of_targets.images
            self.tally.robust += _robust(found.targets)
        if found.cells is not None and self.cells is not None:
            self.cells.add(found.cells.visits, found.cells.nearest_km)
            self.tally.cell_opportunities += found.cells.count
            self.tally.cell_images += found.cells.images
            if self._cell_rows is not None:
                for part in self._of_cells.parts(found.satellite, found.cells):
                    self._cell_rows.write(part)
        if self._points is not None:
            for points in tables.specular_points_parts(self.access, found):
                self._points.write(points)
        self.access.satellites.append(replace(found, targets=None, cells=None, track=None))

    def close(self) -> None:
        """Finish the tables that were written in parts."""
        self._stack.close()
        self.tally.opportunities = self._opportunities.rows
        self.tally.specular_points = 0 if self._points is None else self._points.rows

    def reference(self, name: str) -> ArtifactRef | None:
        """The reference to a table written in parts; None if it was not asked for."""
        return self._context.ref(name) if name in self._context.outputs else None

    def write_revisit(self) -> ArtifactRef | None:
        """Visits and gaps by target."""
        if self.targets is None:
            return None
        frame = self.targets.frame()
        frame.insert(0, "target_id", self._target_id)
        return self._small("revisit.parquet", frame, REVISIT)

    def write_cells(self) -> ArtifactRef | None:
        """The grid's cells with their visits and gaps."""
        grid = self.access.grid
        if self.cells is None or grid is None:
            return None
        return self._small("cells.parquet", _cells_frame(grid, self.cells), CELLS)

    def write_cell_map(self) -> ArtifactRef | None:
        """Visits and longest waits as a cloud-optimised GeoTIFF, where the grid is an even one."""
        from affine import Affine

        from shared.contracts.cog import write_cog

        grid = self.access.grid
        if self.cells is None or grid is None or grid.shape is None or grid.origin_deg is None or not grid.spacing_deg:
            return None
        frame = self.cells.frame()
        bands = {}
        for name in ("visits", "longest_wait_h", "mean_gap_h"):
            band = np.full(grid.shape, np.nan, dtype=np.float32)
            band[grid.row, grid.column] = frame[name]
            bands[name] = band
        top, west = grid.origin_deg
        write_cog(
            self._context.new_file("cell_coverage.tif"),
            bands,
            transform=Affine(grid.spacing_deg, 0.0, west, 0.0, -grid.spacing_deg, top),
            crs="EPSG:4326",
            nodata=float("nan"),
            attributes=self._context.product_attributes(),
        )
        return self._context.ref("cell_coverage.tif")

    def _table(self, name: str, empty: pd.DataFrame, contract: str) -> TableWriter:
        return self._stack.enter_context(self._context.table_writer(name, empty, contract))

    def _small(self, name: str, frame: pd.DataFrame, contract: TableSchema) -> ArtifactRef:
        write_table(self._context.new_file(name), frame, contract, self._context.product_attributes())
        return self._context.ref(name)


def _cells_frame(grid: CellGrid, cells: Revisits) -> pd.DataFrame:
    import geopandas
    import shapely

    frame = cells.frame()
    if grid.row is not None:
        frame.insert(0, "column", grid.column)
        frame.insert(0, "row", grid.row)
    frame.insert(0, "cell_id", np.arange(len(grid), dtype=np.int64))
    centres = shapely.points(grid.longitude_deg, grid.latitude_deg)
    return geopandas.GeoDataFrame(frame, geometry=centres, crs="EPSG:4326")


def _robust(seen: Seen) -> int:
    if seen.ahead is None or seen.behind is None:
        return 0
    return int((seen.ahead & seen.behind).sum())
