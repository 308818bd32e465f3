"""A service that starts before its PostgreSQL and its S3 store waits for them, and shares the database with others."""

from __future__ import annotations

import threading
import time
import uuid
from contextlib import ExitStack
from pathlib import Path

import fsspec
import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from shared.errors import SmokeglintError
from shared.process.app import create_app
from shared.process.jobs import JobRegister, JobRequest
from shared.process.service import Service
from shared.settings import ServiceSettings
from tests.shared.servers import S3_ENVIRONMENT, free_port, postgresql, s3_server

ASKED = JobRequest("sleep", {"seconds": 1}, "h", None, "cycle", "ops")


def test_a_service_waits_for_stores_that_come_up_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    from toy_processes import PROCESSES

    s3_port, database_port = free_port(), free_port()
    for name, value in (S3_ENVIRONMENT | {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{s3_port}"}).items():
        monkeypatch.setenv(name, value)
    fsspec.get_filesystem_class("s3").clear_instance_cache()  # of other tests, with another server
    bucket = f"bucket-{uuid.uuid4().hex}"
    url = f"postgresql+psycopg://smokeglint@127.0.0.1:{database_port}/postgres"
    settings = ServiceSettings(artifact_root=f"s3://{bucket}/artifacts", job_database=url, wait_s=120.0)
    answers: list[int] = []

    def serve() -> None:
        app = create_app("toy", "Toy", PROCESSES, module="toy_processes", settings=settings)
        with TestClient(app, raise_server_exceptions=False) as client:
            deadline = time.monotonic() + 60
            while not answers or (answers[-1] != 200 and time.monotonic() < deadline):
                answers.append(client.get("/readyz").status_code)
                time.sleep(0.1)

    with ExitStack() as servers:
        service = threading.Thread(target=serve)
        service.start()
        time.sleep(0.5)
        servers.enter_context(postgresql(database_port))
        assert service.is_alive() and not answers, "it waits"
        servers.enter_context(s3_server(s3_port))
        fsspec.filesystem("s3", skip_instance_cache=True).mkdir(bucket)
        service.join(120)
        assert answers[-1] == 200

        registers = [JobRegister(url, schema=name) for name in ("access", "planning")]
        jobs = [register.submit(ASKED)[0].id for register in registers]
        assert [[job.id for job in register.all()] for register in registers] == [[job] for job in jobs]
        database = sa.create_engine(url)
        assert {"access", "planning", "toy"} <= set(sa.inspect(database).get_schema_names())
        database.dispose()
        for register in registers:
            register.close()
    fsspec.get_filesystem_class("s3").clear_instance_cache()


def test_a_store_that_never_comes_up_ends_the_wait(tmp_path: Path) -> None:
    in_the_way = tmp_path / "artifacts"
    service = Service("toy", [], "toy_processes", ServiceSettings(artifact_root=str(in_the_way), wait_s=0.0))
    (in_the_way / ".staging").write_text("no folder can be made here")
    with pytest.raises(SmokeglintError, match="Nothing can be written under"):
        service.start()
    service.stop()
