"""The job register: a database of what was asked and how it went. Losing it loses no work."""

from __future__ import annotations

import contextlib
import json
import time
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import Any, Literal

import sqlalchemy as sa

from shared.errors import ConflictError, NotFoundError, TooManyJobsError, UnavailableError
from shared.telemetry import logger

Status = Literal["accepted", "running", "successful", "failed", "dismissed"]
FINAL = ("successful", "failed", "dismissed")
_START_WAIT_S, _START_PAUSE_S = 60.0, 0.5

_metadata = sa.MetaData()
_jobs = sa.Table(
    "jobs",
    _metadata,
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("sequence", sa.Integer, nullable=False, index=True),
    sa.Column("process", sa.String(80), nullable=False),
    sa.Column("status", sa.String(16), nullable=False),
    sa.Column("progress", sa.Float, nullable=False, default=0.0),
    sa.Column("message", sa.Text, nullable=False, default=""),
    sa.Column("inputs", sa.Text, nullable=False),
    sa.Column("outputs", sa.Text),
    sa.Column("problem", sa.Text),
    sa.Column("idempotency_key", sa.String(200), unique=True),
    sa.Column("body_hash", sa.String(64), nullable=False),
    sa.Column("correlation_id", sa.String(128), nullable=False),
    sa.Column("owner", sa.String(128), nullable=False),
    sa.Column("created", sa.String(32), nullable=False),
    sa.Column("updated", sa.String(32), nullable=False),
)


@dataclass(frozen=True)
class JobStatus:
    """How a job stands. ``problem`` is None unless it has ended badly."""

    id: str
    process: str
    status: Status
    progress: float
    message: str
    problem: dict[str, Any] | None
    created: str
    updated: str

    @property
    def ended(self) -> bool:
        return self.status in FINAL


@dataclass(frozen=True)
class Job(JobStatus):
    """One request and its state. ``outputs`` is None until it has ended well."""

    inputs: dict[str, Any]
    outputs: dict[str, Any] | None
    correlation_id: str
    owner: str


_STATUS = [_jobs.c[field.name] for field in fields(JobStatus)]


@dataclass(frozen=True)
class JobRequest:
    """What is asked, by whom, under which idempotency key and correlation id."""

    process: str
    inputs: Mapping[str, Any]
    body_hash: str
    idempotency_key: str | None
    correlation_id: str
    owner: str = ""


class JobRegister:
    """Jobs of one service, one replica a database. Thread-safe through the engine's own connections.

    Every method raises UnavailableError while the database cannot be reached or written. A database that comes up
    after its service is waited for. ``schema`` names the tables' schema on PostgreSQL, so that services can share one
    database; SQLite has none. ``readers_never_wait`` tells of a SQLite file with a write-ahead log, which can be read
    while another writes.
    """

    def __init__(self, url: str, wait_s: float = _START_WAIT_S, schema: str = "") -> None:
        # A server that was restarted has closed the pooled connections: each is tried before it is used.
        options: dict[str, Any] = {"connect_args": {"timeout": 30}}
        if url.startswith("postgresql"):
            options = {"connect_args": {"connect_timeout": 10}, "pool_pre_ping": True}
        self._schema = schema if url.startswith("postgresql") and schema else None
        engine = sa.create_engine(url, **options)
        self._engine = engine.execution_options(schema_translate_map={None: self._schema}) if self._schema else engine
        self.readers_never_wait = False
        self._await(wait_s)

    def _await(self, wait_s: float) -> None:
        deadline, pause_s = time.monotonic() + wait_s, _START_PAUSE_S
        while True:
            try:
                self._prepare()
                return
            except UnavailableError as error:
                if time.monotonic() > deadline:
                    raise
                logger().warning("waiting for the job database", again_in_s=pause_s, error=str(error.__cause__)[:300])
                time.sleep(pause_s)
                pause_s = min(2 * pause_s, 10.0)

    def _prepare(self) -> None:
        with _reached():
            self.readers_never_wait = self._engine.dialect.name == "sqlite" and self._write_ahead() == "wal"
            if self._schema:
                with self._engine.begin() as connection:
                    connection.execute(sa.schema.CreateSchema(self._schema, if_not_exists=True))
            if _outdated(self._engine, self._schema):
                _metadata.drop_all(self._engine)  # a release with other columns; the register holds no work
            _metadata.create_all(self._engine)

    def _write_ahead(self) -> str:
        """Ask SQLite for a write-ahead log; the mode it is in then. Not every file system has what that takes."""
        with self._engine.connect() as connection:
            return str(connection.exec_driver_sql("PRAGMA journal_mode=WAL").scalar_one())

    @contextlib.contextmanager
    def _changing(self) -> Iterator[sa.Connection]:
        with _reached(), self._engine.begin() as connection:
            yield connection

    @contextlib.contextmanager
    def _reading(self) -> Iterator[sa.Connection]:
        with _reached(), self._engine.connect() as connection:
            yield connection

    def answers(self) -> bool:
        """Whether the database can be read."""
        try:
            with self._reading() as connection:
                connection.execute(sa.select(sa.literal(1)))
        except UnavailableError:
            return False
        return True

    def close(self) -> None:
        """Release the database."""
        self._engine.dispose()

    def submit(self, asked: JobRequest, limit: int = 0) -> tuple[Job, bool]:
        """A new job, or the earlier one of the same idempotency key; and whether it is new.

        A key is freed by a job that failed or was dismissed. ConflictError: the key was used for another body.
        TooManyJobsError: the owner has ``limit`` jobs waiting or running already (0: no limit).
        """
        try:
            return self._submit(asked, limit)
        except sa.exc.IntegrityError:  # another request took the key in between: now its job is found
            return self._submit(asked, limit)

    def _submit(self, asked: JobRequest, limit: int) -> tuple[Job, bool]:
        with self._changing() as connection:
            if asked.idempotency_key:
                earlier = self._by_key(connection, asked.idempotency_key, asked.body_hash)
                if earlier is not None:
                    return earlier, False
            if limit:
                _check_limit(connection, asked.owner, limit)
            sequence = (
                connection.execute(sa.select(sa.func.coalesce(sa.func.max(_jobs.c.sequence), 0))).scalar_one() + 1
            )
            row = {
                "id": uuid.uuid4().hex,
                "sequence": sequence,
                "process": asked.process,
                "status": "accepted",
                "progress": 0.0,
                "message": "",
                "inputs": json.dumps(asked.inputs),
                "idempotency_key": asked.idempotency_key,
                "body_hash": asked.body_hash,
                "correlation_id": asked.correlation_id,
                "owner": asked.owner,
                "created": _now(),
                "updated": _now(),
            }
            connection.execute(sa.insert(_jobs).values(row))
        return self.get(str(row["id"])), True

    def _by_key(self, connection: sa.Connection, key: str, body_hash: str) -> Job | None:
        row = connection.execute(sa.select(_jobs).where(_jobs.c.idempotency_key == key)).mappings().first()
        if row is None:
            return None
        if row["status"] in ("failed", "dismissed"):
            connection.execute(sa.update(_jobs).where(_jobs.c.id == row["id"]).values(idempotency_key=None))
            return None
        if row["body_hash"] != body_hash:
            raise ConflictError(f"The Idempotency-Key '{key}' was used for another request; take a new one.")
        return _job(dict(row))

    def get(self, job_id: str) -> Job:
        """One job; NotFoundError if there is none of that id."""
        return _job(self._row(job_id, sa.select(_jobs)))

    def status(self, job_id: str) -> JobStatus:
        """How one job stands: asked for often, so its inputs and outputs are left alone. NotFoundError as ``get``."""
        return _job_status(self._row(job_id, sa.select(*_STATUS)))

    def _row(self, job_id: str, query: sa.Select[Any]) -> dict[str, Any]:
        with self._reading() as connection:
            row = connection.execute(query.where(_jobs.c.id == job_id)).mappings().first()
        if row is None:
            raise NotFoundError("job", job_id)
        return {str(name): value for name, value in row.items()}

    def all(self, limit: int = 1000, offset: int = 0) -> list[JobStatus]:
        """How the newest jobs stand, newest first, after leaving out the ``offset`` newest."""
        query = sa.select(*_STATUS).order_by(_jobs.c.sequence.desc()).limit(limit).offset(offset)
        with self._reading() as connection:
            return [_job_status(dict(row)) for row in connection.execute(query).mappings()]

    def update(self, job_id: str, status: Status, **values: Any) -> bool:
        """Move a job on unless it has ended; whether it was moved. ``outputs`` and ``problem`` are mappings."""
        encoded = {
            name: json.dumps(value) if name in ("outputs", "problem") else value for name, value in values.items()
        }
        change = sa.update(_jobs).where(_jobs.c.id == job_id, _jobs.c.status.not_in(FINAL))
        with self._changing() as connection:
            return connection.execute(change.values(status=status, updated=_now(), **encoded)).rowcount > 0

    def free_key(self, job_id: str) -> None:
        """Forget the idempotency key of a job, so that the same request makes a new one."""
        with self._changing() as connection:
            connection.execute(sa.update(_jobs).where(_jobs.c.id == job_id).values(idempotency_key=None))

    def recover(self, problem: Mapping[str, Any]) -> list[Job]:
        """After a restart: running jobs have failed with ``problem``; the queued ones are returned, oldest first."""
        query = sa.select(_jobs).where(_jobs.c.status == "accepted").order_by(_jobs.c.sequence)
        failed = sa.update(_jobs).where(_jobs.c.status == "running")
        with self._changing() as connection:
            connection.execute(failed.values(status="failed", problem=json.dumps(problem), updated=_now()))
            return [_job(dict(row)) for row in connection.execute(query).mappings()]


# Beside what cannot be reached: a server that only reads just now (a failover), and no free connection for 30 s.
_AWAY = (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.InternalError, sa.exc.TimeoutError)


@contextlib.contextmanager
def _reached() -> Iterator[None]:
    try:
        yield
    except _AWAY as error:
        raise UnavailableError("The job register cannot be reached or written just now; try again.") from error


def _outdated(engine: sa.Engine, schema: str | None) -> bool:
    """Whether the database holds a jobs table with other columns than this release's."""
    inspector = sa.inspect(engine)
    if not inspector.has_table(_jobs.name, schema):
        return False
    found = inspector.get_columns(_jobs.name, schema)
    return {column["name"] for column in found} != {column.name for column in _jobs.c}


def _check_limit(connection: sa.Connection, owner: str, limit: int) -> None:
    mine = sa.select(sa.func.count()).where(_jobs.c.owner == owner, _jobs.c.status.not_in(FINAL))
    open_jobs = connection.execute(mine).scalar_one()
    if open_jobs >= limit:
        raise TooManyJobsError(f"'{owner}' has {open_jobs} jobs waiting or running; the limit is {limit}.")


def _job_status(row: Mapping[Any, Any]) -> JobStatus:
    return JobStatus(**{**row, "problem": json.loads(row["problem"]) if row["problem"] else None})


def _job(row: Mapping[Any, Any]) -> Job:
    decoded: dict[str, Any] = {
        name: json.loads(row[name]) if row[name] else None for name in ("inputs", "outputs", "problem")
    }
    names = ("id", "process", "status", "progress", "message", "correlation_id", "owner", "created", "updated")
    return Job(**{name: row[name] for name in names}, **decoded)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
