"""The job register on PostgreSQL: the same answers as on SQLite, asked by many at once, and restarted."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import psycopg
import pytest

from shared.errors import ConflictError, UnavailableError
from shared.process.jobs import JobRegister, JobRequest
from tests.shared.servers import free_port, postgresql


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with postgresql() as url:
        yield url


def ask(register: JobRegister, key: str | None, body: str = "h") -> tuple[str, bool]:
    job, is_new = register.submit(JobRequest("sleep", {"seconds": 1}, body, key, "cycle", "ops"))
    return job.id, is_new


def test_jobs_survive_their_service(url: str) -> None:
    register = JobRegister(url)
    running, waiting = ask(register, None)[0], ask(register, None)[0]
    register.update(running, "running", progress=40.0)
    register.close()
    again = JobRegister(url)
    assert waiting in [job.id for job in again.recover({"title": "restarted", "status": 500})]
    assert (again.get(running).status, again.get(running).problem) == ("failed", {"title": "restarted", "status": 500})
    again.close()


def test_a_server_that_was_restarted_is_reached_again(url: str) -> None:
    register = JobRegister(url)
    job = ask(register, None)[0]
    with psycopg.connect(url.replace("+psycopg", ""), autocommit=True) as connection:
        others = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()"
        connection.execute(others + " AND datname = current_database()")
    assert register.get(job).status == "accepted" and register.answers()
    register.close()


def test_a_server_that_is_not_there_is_said_to_be_away() -> None:
    with pytest.raises(UnavailableError):
        JobRegister(f"postgresql+psycopg://smokeglint@127.0.0.1:{free_port()}/postgres", wait_s=0.0)


def test_one_key_asked_by_many_at_once_is_one_job(url: str) -> None:
    register = JobRegister(url)
    with ThreadPoolExecutor(12) as pool:
        answers = list(pool.map(lambda _: ask(register, "k"), range(36)))
    assert len({job for job, _ in answers}) == 1 and sum(is_new for _, is_new in answers) == 1
    with pytest.raises(ConflictError):
        ask(register, "k", "other")
    register.close()


def test_an_ended_job_stays_ended_and_frees_its_key(url: str) -> None:
    register = JobRegister(url)
    first, _ = ask(register, "freed")
    assert register.update(first, "failed", problem={"status": 500})
    assert not register.update(first, "running")
    assert ask(register, "freed")[0] != first
    register.close()
