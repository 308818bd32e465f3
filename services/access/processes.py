"""The processes of the access service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AwareDatetime, BeforeValidator, Field

from services.access.orbits.constellations import CONSTELLATIONS
from shared.artifacts.reference import ArtifactRef
from shared.process.context import JobContext
from shared.process.declaration import Process, ProcessInputs, ProcessOutputs

if TYPE_CHECKING:
    from services.access.fleets import Fleet
    from services.access.prediction import Access


def _constellation_name(given: object) -> object:
    """``G``, ``E``, ``C``, ``J`` and names in any case stand for a constellation, too."""
    names = {name.upper(): name for name in CONSTELLATIONS.values()} | CONSTELLATIONS
    return names.get(given.strip().upper(), given) if isinstance(given, str) else given


ORBIT_FORMATS = "TLE text, CCSDS OMM (JSON list, XML, KVN), CCSDS OEM (KVN, XML) or SP3, recognised by content"
Constellation = Annotated[Literal["GPS", "Galileo", "BeiDou", "QZSS"], BeforeValidator(_constellation_name)]


class PredictAccessInputs(ProcessInputs):
    """Orbits, ground stations and point targets, and the time to predict."""

    receivers: ArtifactRef | list[ArtifactRef] = Field(
        description="orbits of the receiving satellites, one file or several: " + ORBIT_FORMATS
    )
    transmitters: ArtifactRef | list[ArtifactRef] = Field(
        description="orbits of the GNSS satellites, one file or several: " + ORBIT_FORMATS
    )
    constellations: list[Constellation] | None = Field(
        None, min_length=1, description="constellations whose signals are used; null: all that the transmitters hold"
    )
    fleet: Literal["cygnss", "example_commercial"] | ArtifactRef | None = Field(
        None,
        description="list of the receivers to use, by catalogue number: a shipped one by name, or JSON of the same "
        "shape (services/access/fleets); null: all that the receivers hold",
    )
    min_contact_s: float = Field(
        0.0, ge=0, le=3600, description="contacts shorter than this (s) are left out and named in the report"
    )
    stations: ArtifactRef = Field(description="stations table")
    targets: ArtifactRef = Field(description="targets table: points to be covered")
    start: AwareDatetime = Field(description="start of the horizon, a whole second, with its time zone")
    duration_s: int = Field(86400, gt=0, le=14 * 86400, description="length of the horizon, s")
    step_s: int = Field(1, ge=1, le=600, description="time between images, s; must divide duration_s")
    target_radius_km: float = Field(
        10.0, ge=0.1, le=200, description="a target this near (km) to a specular point is covered by the image"
    )
    max_incidence_deg: float = Field(
        65.0, gt=0, le=85, description="largest incidence angle at a specular point, degrees"
    )
    max_element_age_days: float = Field(
        30.0, gt=0, le=365, description="satellites whose elements are further from the start (days) are left out"
    )
    with_specular_points: bool = Field(False, description="also write the specular tracks")
    with_figures: bool = Field(False, description="also draw pictures for people (PNG)")
    area: tuple[float, float, float, float] | None = Field(
        None,
        description="lon_min, lat_min, lon_max, lat_max (degrees) that specular_points is limited to; "
        "lon_min > lon_max crosses the dateline; null: the whole globe",
    )


class PredictAccessOutputs(ProcessOutputs):
    """Where and when each satellite can record, downlink, and draw power from the Sun."""

    opportunities: ArtifactRef = Field(description="opportunities table: a row per image and target")
    contacts: ArtifactRef = Field(description="contacts table")
    eclipses: ArtifactRef = Field(description="eclipses table, umbra and penumbra")
    specular_points: ArtifactRef | None = Field(None, description="specular tracks, where asked for")
    report: ArtifactRef = Field(description="JSON: ages of the elements, warnings, satellites left out, counts")
    timeline: ArtifactRef | None = Field(None, description="PNG of contacts and eclipses, where figures are asked for")
    warnings: list[str] = Field(
        default_factory=list, description="old or too new orbits, satellites left out, short contacts"
    )
    opportunity_count: int = Field(description="rows of opportunities")
    image_count: int = Field(description="images that cover at least one target")
    contact_count: int = Field(description="rows of contacts")
    eclipse_count: int = Field(description="rows of eclipses")
    targets_covered: int = Field(description="targets covered by at least one image")


def predict_access(inputs: PredictAccessInputs, context: JobContext) -> PredictAccessOutputs:
    """Run one prediction; core errors name the field, line or row at fault."""
    from dataclasses import replace

    import numpy as np

    from services.access import prediction, products
    from services.access.events.contacts import stations_from
    from services.access.orbits.constellations import letters_of
    from services.access.orbits.formats import read_files

    targets = context.read_table(inputs.targets, "TARGETS")
    stations = stations_from(context.read_table(inputs.stations, "STATIONS").to_dict("records"))
    receivers, transmitters = (
        read_files([(one.name, context.path(one).read_text(encoding="utf-8", errors="replace")) for one in files], name)
        for name, files in (("receivers", _each(inputs.receivers)), ("transmitters", _each(inputs.transmitters)))
    )
    fleet, letters = _fleet(inputs, context), letters_of(inputs.constellations)
    missing: dict[str, str] = {}
    if fleet is not None:
        receivers, missing = fleet.pick(receivers)
        letters = letters or fleet.constellations
        if fleet.example:
            context.mark_simulated()
    access = prediction.predict(
        receivers,
        transmitters,
        stations,
        (targets.geometry.y.to_numpy(), targets.geometry.x.to_numpy()),
        prediction.Horizon(inputs.start, inputs.duration_s, inputs.step_s),
        prediction.AccessOptions(
            target_radius_km=inputs.target_radius_km,
            max_incidence_deg=inputs.max_incidence_deg,
            max_element_age_days=inputs.max_element_age_days,
            with_specular_points=inputs.with_specular_points,
            area=inputs.area,
            constellations=letters,
            min_contact_s=inputs.min_contact_s,
        ),
        context.progress,
    )
    access = replace(access, dropped=access.dropped | missing)
    context.progress(85, "writing tables")
    summary = products.report(access, len(targets))
    opportunities = products.opportunities_frame(access, targets["target_id"].to_numpy(np.int64))
    points = None
    if inputs.with_specular_points:
        points = context.write_table(
            "specular_points.parquet", products.specular_points_frame(access), "SPECULAR_POINTS"
        )
    counts = summary["counts"]
    return PredictAccessOutputs(
        opportunities=context.write_table("opportunities.parquet", opportunities, "OPPORTUNITIES"),
        contacts=context.write_table("contacts.parquet", products.contacts_frame(access), "CONTACTS"),
        eclipses=context.write_table("eclipses.parquet", products.eclipses_frame(access), "ECLIPSES"),
        specular_points=points,
        report=context.write_json("report.json", summary),
        timeline=_timeline(access, [station.name for station in stations], context) if inputs.with_figures else None,
        warnings=summary["warnings"],
        opportunity_count=counts["opportunities"],
        image_count=counts["images"],
        contact_count=counts["contacts"],
        eclipse_count=counts["eclipses"],
        targets_covered=counts["targets_covered"],
    )


def _fleet(inputs: PredictAccessInputs, context: JobContext) -> Fleet | None:
    from services.access.fleets import read_fleet, shipped_fleet

    if inputs.fleet is None:
        return None
    if isinstance(inputs.fleet, str):
        return shipped_fleet(inputs.fleet)
    return read_fleet(context.read_json(inputs.fleet))


def _timeline(access: Access, stations: list[str], context: JobContext) -> ArtifactRef:
    from services.access.events.timeline import SatelliteEvents, draw_timeline
    from shared import figures

    rows = [SatelliteEvents(one.track.satellite, one.contacts, one.eclipses) for one in access.satellites]
    figure = draw_timeline(rows, stations, access.horizon.start, float(access.horizon.duration_s))
    figures.save(figure, context.new_file("timeline.png"), context.product_attributes())
    return context.ref("timeline.png")


def _each(reference: ArtifactRef | list[ArtifactRef]) -> list[ArtifactRef]:
    return reference if isinstance(reference, list) else [reference]


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.access.prediction",
    "services.access.products",
    "shared.contracts.tables",
)

PROCESSES = [
    Process(
        id="predict-access",
        title="Predict access",
        description="Specular points of GNSS-R satellites on WGS84, the targets they cover second by second, contacts "
        "with ground stations and eclipses, from element sets by SGP4 or from ephemerides.",
        inputs=PredictAccessInputs,
        outputs=PredictAccessOutputs,
        run=predict_access,
    )
]
