"""The processes of the access service."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AwareDatetime, BaseModel, BeforeValidator, ConfigDict, Field

from services.access.orbits.constellations import CONSTELLATIONS
from shared.artifacts.reference import ArtifactRef
from shared.process.context import JobContext
from shared.process.declaration import Process, ProcessInputs, ProcessOutputs


def _constellation_name(given: object) -> object:
    """``G``, ``E``, ``C``, ``J`` and names in any case stand for a constellation, too."""
    names = {name.upper(): name for name in CONSTELLATIONS.values()} | CONSTELLATIONS
    return names.get(given.strip().upper(), given) if isinstance(given, str) else given


ORBIT_FORMATS = "TLE text, CCSDS OMM (JSON list, XML, KVN), CCSDS OEM (KVN, XML) or SP3, recognised by content"
Files = Annotated[list[ArtifactRef], Field(min_length=1, max_length=64)]
Constellation = Annotated[Literal["GPS", "Galileo", "BeiDou", "QZSS"], BeforeValidator(_constellation_name)]


class GridInputs(BaseModel):
    """Cells of even spacing in degrees over a box or the globe."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    spacing_deg: float = Field(ge=0.01, le=30, description="width and height of a cell, degrees")
    area: tuple[float, float, float, float] | None = Field(
        None, description="lon_min, lat_min, lon_max, lat_max; lon_min > lon_max crosses the dateline; null: the globe"
    )
    land_only: bool = Field(False, description="cells whose middle lies on land only (Natural Earth 1:110m)")


class PredictAccessInputs(ProcessInputs):
    """Orbits, ground stations and point targets, and the time to predict."""

    receivers: ArtifactRef | Files = Field(
        description="orbits of the receiving satellites, one file or several: " + ORBIT_FORMATS
    )
    transmitters: ArtifactRef | Files = Field(
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
    targets: ArtifactRef | None = Field(
        None, description="targets table: points to be covered; null: tracks, contacts and eclipses only"
    )
    grid: GridInputs | None = Field(None, description="an even grid of cells to be covered, beside any targets")
    grid_cells: ArtifactRef | None = Field(
        None, description="cells by their centres instead: Parquet with latitude_deg and longitude_deg"
    )
    with_cell_opportunities: bool = Field(
        False, description="also write a row per image and cell (images numbered apart from those of targets)"
    )
    start: AwareDatetime = Field(description="start of the horizon, a whole second, with its time zone")
    duration_s: int = Field(86400, gt=0, le=14 * 86400, description="length of the horizon, s")
    step_s: int = Field(1, ge=1, le=600, description="time between images, s; must divide duration_s")
    target_radius_km: float = Field(
        10.0, ge=0.1, le=200, description="a target this near (km) to a specular point is covered by the image"
    )
    covered_by: Literal["radius", "footprint"] = Field(
        "radius",
        description="what covers: target_radius_km about a specular point, or its footprint, the first Fresnel zone "
        "stretched by incidence and moved for one second; a cell is covered by its middle or by a footprint's touch",
    )
    mode: Literal["raw-if", "nominal"] = Field(
        "raw-if",
        description="which specular points an image holds: raw-if, every one in the antenna beams; nominal, those of "
        "highest gain, as many as the receiver has channels",
    )
    max_incidence_deg: float = Field(
        65.0, gt=0, le=85, description="largest incidence angle at a specular point, degrees"
    )
    surface_height_m: float = Field(
        0.0, ge=-500, le=9000, description="height of the reflecting surface over WGS84, m; targets lie on it, too"
    )
    antenna: ArtifactRef | None = Field(
        None,
        description="JSON of the receivers' antennas: channels, floor_dbi, and for each antenna its tilt and gain "
        "table (services/access/specular/antennas/cygnss.json is one); null: CYGNSS",
    )
    satellite_roll: ArtifactRef | None = Field(
        None,
        description="Parquet with satellite, time, roll_deg: roll about the flight direction (positive: starboard "
        "down), straight lines between times; null: no roll",
    )
    along_track_error_km: float | None = Field(
        None,
        ge=0,
        le=500,
        description="along-track error of receivers that covered_ahead and covered_behind are worked out for; null: "
        "from the age of their elements",
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
    revisit: ArtifactRef | None = Field(None, description="visits and the gaps between them, a row per target")
    cells: ArtifactRef | None = Field(None, description="the grid's cells with visits and gaps, GeoParquet")
    cell_coverage: ArtifactRef | None = Field(None, description="visits and waits of an even grid, GeoTIFF (COG)")
    cell_opportunities: ArtifactRef | None = Field(
        None, description="opportunities table of the cells, target_id being the cell_id, where asked for"
    )
    report: ArtifactRef = Field(description="JSON: ages of the elements, warnings, satellites left out, counts")
    timeline: ArtifactRef | None = Field(None, description="PNG of contacts and eclipses, where figures are asked for")
    map: ArtifactRef | None = Field(None, description="PNG of ground tracks and coverage, where figures are asked for")
    warnings: list[str] = Field(
        default_factory=list, description="old or too new orbits, satellites left out, short contacts"
    )
    opportunity_count: int = Field(description="rows of opportunities")
    image_count: int = Field(description="images that cover at least one target")
    contact_count: int = Field(description="rows of contacts")
    eclipse_count: int = Field(description="rows of eclipses")
    targets_covered: int = Field(description="targets covered by at least one image")
    cells_covered: int = Field(0, description="cells covered by at least one image")


def predict_access(inputs: PredictAccessInputs, context: JobContext) -> PredictAccessOutputs:
    """Run one prediction; core errors name the field, line or row at fault."""
    from services.access.step import run_prediction

    return run_prediction(inputs, context)


# Imported by a worker before its first job; the HTTP side stays light.
WARM_MODULES = (
    "services.access.step",
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
