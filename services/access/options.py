"""What counts as access."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from services.access.specular.antenna import AntennaSystem, shipped_antennas
from shared.errors import DomainError

Area = tuple[float, float, float, float]


@dataclass(frozen=True)
class AccessOptions:
    """What counts as access.

    ``target_radius_km`` about a specular point, or with ``by_footprint`` its footprint; an incidence limit; the
    antennas; ``raw-if``: every point in the beams, ``nominal``: as many as there are channels, by gain; the height of
    the surface over WGS84; ``along_track_error_km`` in place of what the elements' age gives; the oldest elements; the
    area that specular points are kept in (lon_min, lat_min, lon_max, lat_max; lon_min > lon_max crosses the dateline);
    letters of the constellations used (None: all), and the shortest contact that counts.
    """

    target_radius_km: float = 10.0
    max_incidence_deg: float = 65.0
    antennas: AntennaSystem = field(default_factory=shipped_antennas)
    max_element_age_days: float = 30.0
    with_specular_points: bool = False
    area: Area | None = None
    constellations: tuple[str, ...] | None = None
    min_contact_s: float = 0.0
    mode: Literal["raw-if", "nominal"] = "raw-if"
    by_footprint: bool = False
    surface_height_m: float = 0.0
    along_track_error_km: float | None = None

    def __post_init__(self) -> None:
        if self.area is None:
            return
        west, south, east, north = self.area
        if not (-180 <= west <= 180 and -180 <= east <= 180 and -90 <= south < north <= 90 and west != east):
            raise DomainError(
                f"area {self.area} is not a box.",
                field="area",
                value=self.area,
                accepted="lon_min, lat_min, lon_max, lat_max in degrees; lon_min > lon_max crosses the dateline",
            )

    @property
    def radius_km(self) -> float | None:
        """The radius that covers; None where the footprint does."""
        return None if self.by_footprint else self.target_radius_km
