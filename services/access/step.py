"""predict-access as a step: its inputs read and checked, the prediction run, its artifacts written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from services.access import prediction, tables
from services.access.coverage.grid import CellGrid, cells_at, even_grid
from services.access.delivery import Delivery
from services.access.events.contacts import Station, stations_from
from services.access.orbits.constellations import letters_of
from services.access.orbits.formats import Orbit, read_files
from services.access.processes import PredictAccessInputs, PredictAccessOutputs
from services.access.report import report
from services.access.satellite import satellite_access
from services.access.specular.antenna import antenna_system, shipped_antennas
from services.access.specular.roll import read_rolls
from shared.artifacts.reference import ArtifactRef
from shared.errors import DomainError
from shared.fan_out import fan_out_in_turn
from shared.process.context import JobContext

if TYPE_CHECKING:
    from services.access.fleets import Fleet
    from services.access.prediction import Access

Places = tuple[NDArray[np.float64], NDArray[np.float64]]


def run_prediction(inputs: PredictAccessInputs, context: JobContext) -> PredictAccessOutputs:
    """Run one prediction; core errors name the field, line or row at fault."""
    stations = stations_from(context.read_table(inputs.stations, "STATIONS").to_dict("records"))
    target_id, places = _targets(inputs, context)
    access, tasks = _prepare(inputs, context, stations, places)
    context.progress(10, f"{len(tasks)} receivers and {len(access.transmitters)} transmitters propagated")
    with Delivery(context, access, target_id, inputs.with_cell_opportunities) as delivery:
        for done, found in enumerate(fan_out_in_turn(satellite_access, tasks), start=1):
            delivery.add(found)
            context.progress(10 + 75 * done / len(tasks), f"specular points and events of {found.satellite}")
        delivery.close()
        context.progress(86, "writing tables")
        return _outputs(inputs, context, delivery, stations, places)


def _prepare(
    inputs: PredictAccessInputs,
    context: JobContext,
    stations: list[Station],
    places: Places | None,
) -> tuple[Access, list[prediction.Task]]:
    receivers, transmitters = (
        _orbits(context, files, name)
        for name, files in (("receivers", inputs.receivers), ("transmitters", inputs.transmitters))
    )
    fleet, letters = _fleet(inputs, context), letters_of(inputs.constellations)
    missing: dict[str, str] = {}
    if fleet is not None:
        receivers, missing = fleet.pick(receivers)
        letters = letters or fleet.constellations
        if fleet.example:
            context.mark_simulated()
    horizon = prediction.Horizon(inputs.start, inputs.duration_s, inputs.step_s)
    rolls = None
    if inputs.satellite_roll is not None:
        names = {orbit.name for orbit in receivers}
        rolls = read_rolls(_frame(context, inputs.satellite_roll, "satellite_roll"), names, horizon.start)
    options = prediction.AccessOptions(
        target_radius_km=inputs.target_radius_km,
        max_incidence_deg=inputs.max_incidence_deg,
        antennas=shipped_antennas() if inputs.antenna is None else antenna_system(context.read_json(inputs.antenna)),
        max_element_age_days=inputs.max_element_age_days,
        with_specular_points=inputs.with_specular_points,
        area=inputs.area,
        constellations=letters,
        min_contact_s=inputs.min_contact_s,
        mode=inputs.mode,
        by_footprint=inputs.covered_by == "footprint",
        surface_height_m=inputs.surface_height_m,
        along_track_error_km=inputs.along_track_error_km,
    )
    access, tasks = prediction.prepare_access(
        receivers,
        transmitters,
        stations,
        places,
        horizon,
        options,
        grid=_grid(inputs, context),
        rolls=rolls,
        with_cell_rows=inputs.with_cell_opportunities,
    )
    return replace(access, dropped=access.dropped | missing), tasks


def _orbits(context: JobContext, files: ArtifactRef | list[ArtifactRef], name: str) -> list[Orbit]:
    each = files if isinstance(files, list) else [files]
    return read_files(
        [(one.name, context.path(one).read_text(encoding="utf-8", errors="replace")) for one in each], name
    )


def _targets(inputs: PredictAccessInputs, context: JobContext) -> tuple[NDArray[np.int64], Places | None]:
    if inputs.targets is None:
        return np.zeros(0, dtype=np.int64), None
    targets = context.read_table(inputs.targets, "TARGETS")
    geometry: Any = targets.geometry
    other = np.flatnonzero(geometry.geom_type != "Point")
    if len(other):
        kind = geometry.geom_type.iloc[other[0]]
        raise DomainError(
            f"targets: row {other[0]} is a {kind}, not a point.", field="targets", value=kind, accepted="points"
        )
    return targets["target_id"].to_numpy(np.int64), (geometry.y.to_numpy(), geometry.x.to_numpy())


def _grid(inputs: PredictAccessInputs, context: JobContext) -> CellGrid | None:
    if inputs.grid is not None and inputs.grid_cells is not None:
        raise DomainError("grid and grid_cells are both given.", field="grid", accepted="one of the two")
    if inputs.grid is not None:
        return even_grid(inputs.grid.spacing_deg, inputs.grid.area, inputs.grid.land_only)
    if inputs.grid_cells is None:
        return None
    from pandas.api.types import is_bool_dtype, is_numeric_dtype

    table = _frame(context, inputs.grid_cells, "grid_cells")
    for name in ("latitude_deg", "longitude_deg"):
        if name not in table.columns or not is_numeric_dtype(table[name]) or is_bool_dtype(table[name]):
            raise DomainError(
                f"grid_cells: the table has no numbers in column {name}.",
                field="grid_cells",
                value=", ".join(map(str, table.columns)),
                accepted="latitude_deg and longitude_deg of each cell's centre",
            )
    degrees = {name: table[name].to_numpy(np.float64, na_value=np.nan) for name in ("latitude_deg", "longitude_deg")}
    return cells_at(**degrees)


def _frame(context: JobContext, reference: ArtifactRef, field: str) -> Any:
    import pandas as pd

    try:
        return pd.read_parquet(context.path(reference))
    except (ValueError, OSError) as error:
        raise DomainError(
            f"{field}: '{reference.name}' cannot be read as Parquet ({error}).", field=field, accepted="a Parquet table"
        ) from error


def _fleet(inputs: PredictAccessInputs, context: JobContext) -> Fleet | None:
    from services.access.fleets import read_fleet, shipped_fleet

    if inputs.fleet is None:
        return None
    if isinstance(inputs.fleet, str):
        return shipped_fleet(inputs.fleet)
    return read_fleet(context.read_json(inputs.fleet))


def _outputs(
    inputs: PredictAccessInputs,
    context: JobContext,
    delivery: Delivery,
    stations: Sequence[Station],
    places: Places | None,
) -> PredictAccessOutputs:
    access = delivery.access
    summary = report(access, delivery.tally, delivery.targets, delivery.cells, stations)
    counts = summary["counts"]
    return PredictAccessOutputs(
        opportunities=context.ref("opportunities.parquet"),
        contacts=context.write_table("contacts.parquet", tables.contacts_frame(access), "CONTACTS"),
        eclipses=context.write_table("eclipses.parquet", tables.eclipses_frame(access), "ECLIPSES"),
        specular_points=delivery.reference("specular_points.parquet"),
        cell_opportunities=delivery.reference("cell_opportunities.parquet"),
        revisit=delivery.write_revisit(),
        cells=delivery.write_cells(),
        cell_coverage=delivery.write_cell_map(),
        report=context.write_json("report.json", summary),
        timeline=_timeline(access, stations, context) if inputs.with_figures else None,
        map=_map(delivery, stations, places, context) if inputs.with_figures else None,
        warnings=summary["warnings"],
        opportunity_count=counts["opportunities"],
        image_count=counts["images"],
        contact_count=counts["contacts"],
        eclipse_count=counts["eclipses"],
        targets_covered=counts["targets_covered"],
        cells_covered=counts["cells_covered"],
    )


def _timeline(access: Access, stations: Sequence[Station], context: JobContext) -> ArtifactRef:
    from services.access.events.timeline import SatelliteEvents, draw_timeline
    from shared import figures

    rows = [SatelliteEvents(one.satellite, one.contacts, one.eclipses) for one in access.satellites]
    names = [station.name for station in stations]
    figure = draw_timeline(rows, names, access.horizon.start, float(access.horizon.duration_s))
    figures.save(figure, context.new_file("timeline.png"), context.product_attributes())
    return context.ref("timeline.png")


def _map(delivery: Delivery, stations: Sequence[Station], places: Places | None, context: JobContext) -> ArtifactRef:
    """Tracks, and the targets by visits; the grid's cells where there are no targets."""
    from services.access.maps import Covered, draw_map
    from shared import figures

    access = delivery.access
    covered = None
    if delivery.targets is not None and places is not None:
        covered = Covered(*places, delivery.targets.frame()["visits"].to_numpy(), "Targets")
    elif delivery.cells is not None and access.grid is not None:
        visits = delivery.cells.frame()["visits"].to_numpy()
        covered = Covered(access.grid.latitude_deg, access.grid.longitude_deg, visits, "Cells")
    hours = access.horizon.duration_s / 3600.0
    title = f"{access.horizon.start:%Y-%m-%d %H:%M} UTC, {hours:g} h"
    figure = draw_map([(one.satellite, one.ground_deg) for one in access.satellites], stations, covered, title)
    figures.save(figure, context.new_file("map.png"), context.product_attributes())
    return context.ref("map.png")
