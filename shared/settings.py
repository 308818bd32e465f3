"""Settings of a service, read from the environment with one prefix each: ``SMOKEGLINT_ACCESS_WORKERS=2``."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from shared.artifacts.roots import Roots, is_local, local_path
from shared.contracts.limits import InputLimits


class ServiceSettings(BaseSettings):
    """What an operator sets for a service. Lists are JSON: ``["/data/cases"]``."""

    model_config = SettingsConfigDict(extra="ignore", frozen=True)
    artifact_root: str = Field("artifacts", description="folder or fsspec URL that artifacts are written under")
    read_roots: tuple[str, ...] = Field((), description="further folders or URLs that inputs may be read from")
    job_database: str = Field("", description="SQLAlchemy URL; a SQLite file below the artifact root by default")
    wait_s: float = Field(300.0, ge=0, description="how long a start waits for store and job database, s")
    workers: int = Field(1, ge=1, le=64, description="worker processes, one job each")
    max_body_bytes: int = Field(1_000_000, ge=1_000, description="largest request body")
    max_table_rows: int = Field(50_000_000, ge=1, description="most rows of a table that a job reads")
    max_grid_bytes: int = Field(8_000_000_000, ge=1, description="largest grid, unpacked, that a job reads")
    max_jobs_per_key: int = Field(32, ge=1, description="jobs that one key may have waiting or running at once")
    api_keys: str = Field("", description="file of API keys; see 'smokeglint key'")
    oidc_issuer: str = Field("", pattern="^(https?://.+)?$", description="issuer of JWT bearer tokens")
    oidc_audience: str = Field("smokeglint", description="audience that tokens must name")
    log_level: str = Field("INFO", pattern="^(DEBUG|INFO|WARNING|ERROR)$")
    parent_pid: int = Field(0, ge=0, description="end when this process, our parent, has gone; 0: never")

    @property
    def roots(self) -> Roots:
        return Roots(self.artifact_root, self.read_roots)

    @property
    def input_limits(self) -> InputLimits:
        return InputLimits(self.max_table_rows, self.max_grid_bytes)

    def database_url(self, service: str) -> str:
        """The job database: as set, else a SQLite file beside the artifacts (here, if the root is remote)."""
        if self.job_database:
            return self.job_database
        root = local_path(self.artifact_root) if is_local(self.artifact_root) else Path()
        folder = (root / ".jobs").resolve()
        folder.mkdir(parents=True, exist_ok=True)
        return f"sqlite:///{folder / f'{service}.sqlite'}"


def service_settings(service: str) -> ServiceSettings:
    """The settings of the named service from the environment; pydantic's ValidationError names a bad one.

    ``SMOKEGLINT_SERVICE_X`` holds for every service, ``SMOKEGLINT_ACCESS_X`` for the access service and before that.
    """
    own = f"SMOKEGLINT_{service.upper()}_"
    common = ServiceSettings(_env_prefix="SMOKEGLINT_SERVICE_").model_dump(exclude_unset=True)  # type: ignore[call-arg]
    specific = ServiceSettings(_env_prefix=own).model_dump(exclude_unset=True)  # type: ignore[call-arg]
    return ServiceSettings(_env_prefix=own, **(common | specific))  # type: ignore[call-arg]
