"""A reference to an artifact: where it lies, what it is, and the hash of what it must hold."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

MEDIA_TYPES = {
    ".parquet": "application/vnd.apache.parquet",
    ".json": "application/json",
    ".geojson": "application/geo+json",
    ".kml": "application/vnd.google-earth.kml+xml",
    ".nc": "application/x-netcdf",
    ".tif": "image/tiff; application=geotiff; profile=cloud-optimized",
    ".png": "image/png",
    ".gif": "image/gif",
    ".csv": "text/csv",
    ".md": "text/markdown",
    ".tle": "text/plain",
    ".txt": "text/plain",
    ".toml": "application/toml",
}


def media_type(name: str) -> str:
    """The media type of a file by its suffix; ``application/octet-stream`` where it is not known."""
    suffix = "." + name.rsplit(".", 1)[-1].lower() if "." in name else ""
    return MEDIA_TYPES.get(suffix, "application/octet-stream")


class ArtifactRef(BaseModel):
    """Anything larger than a screen travels as this. ``href`` is a URL, or a path below the artifact root."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    href: str = Field(
        min_length=1, max_length=2000, description="file:// or other URL, or a path below the artifact root"
    )
    type: str | None = Field(None, description="media type")
    sha256: str | None = Field(None, pattern="^[0-9a-f]{64}$", description="hash of the content; checked when given")

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.href.rstrip("/").rsplit("/", 1)[-1]
