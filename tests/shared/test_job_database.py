"""The job register on PostgreSQL: the same answers as on SQLite, asked by many at once, and restarted."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from shared.errors import ConflictError
from shared.process.jobs import JobRegister, JobRequest
from tests.shared.servers import postgresql


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
