"""The job register: what a key means, what a restart means, and that an end is an end."""

from __future__ import annotations

import contextlib
import sqlite3
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from shared.errors import ConflictError, NotFoundError, TooManyJobsError
from shared.process.jobs import FINAL, Job, JobRegister, JobRequest, Status

PROBLEM = {"title": "The service was restarted", "status": 500}


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'jobs.sqlite'}"


@pytest.fixture
def register(url: str) -> Iterator[JobRegister]:
    opened = JobRegister(url)
    yield opened
    opened.close()


def submit(register: JobRegister, key: str | None = None, body: str = "h1", **inputs: Any) -> Job:
    return register.submit(JobRequest("sleep", inputs, body, key, "cycle-7", "ops"))[0]


def test_a_new_job_is_accepted_and_found_again(register: JobRegister) -> None:
    job, is_new = register.submit(JobRequest("sleep", {"seconds": 1, "area": [1, 2]}, "h1", None, "cycle-7", "ops"))
    assert is_new
    assert (job.process, job.status, job.progress, job.message) == ("sleep", "accepted", 0.0, "")
    assert job.inputs == {"seconds": 1, "area": [1, 2]}
    assert (job.outputs, job.problem, job.correlation_id, job.ended) == (None, None, "cycle-7", False)
    assert job.created.endswith("Z")
    assert register.get(job.id) == job


def test_an_unknown_job_is_named(register: JobRegister) -> None:
    with pytest.raises(NotFoundError, match="none-such") as caught:
        register.get("none-such")
    assert (caught.value.kind, caught.value.identifier) == ("job", "none-such")
    assert not register.update("none-such", "running")


def test_reading_does_not_wait_for_a_writer(register: JobRegister, url: str) -> None:
    job = submit(register)
    with contextlib.closing(sqlite3.connect(url.removeprefix("sqlite:///"), isolation_level=None)) as writer:
        writer.execute("BEGIN EXCLUSIVE")
        assert register.readers_never_wait and register.get(job.id) == job  # without the log: 30 s, then an error


def test_a_database_without_a_write_ahead_log_is_told() -> None:
    register = JobRegister("sqlite://")  # in memory there is none, as on file systems that cannot share memory
    assert not register.readers_never_wait
    register.close()


def test_jobs_are_listed_newest_first(register: JobRegister) -> None:
    made = [submit(register, number=k).id for k in range(4)]
    assert [job.id for job in register.all()] == made[::-1]
    assert [job.id for job in register.all(limit=2)] == [made[3], made[2]]


def test_a_job_moves_on_until_it_ends(register: JobRegister) -> None:
    job = submit(register)
    assert register.update(job.id, "running", progress=40.0, message="points")
    running = register.get(job.id)
    assert (running.status, running.progress, running.message, running.ended) == ("running", 40.0, "points", False)
    assert register.update(job.id, "successful", progress=100.0, outputs={"count": 2, "none": None})
    ended = register.get(job.id)
    assert (ended.status, ended.outputs, ended.ended) == ("successful", {"count": 2, "none": None}, True)


@pytest.mark.parametrize("end", FINAL)
@pytest.mark.parametrize("later", ["running", *FINAL])
def test_an_ended_job_is_not_moved_on(register: JobRegister, end: Status, later: Status) -> None:
    job = submit(register)
    assert register.update(job.id, end, message="the end", problem=PROBLEM)
    before = register.get(job.id)
    assert not register.update(job.id, later, message="after the end", outputs={"count": 1}, problem={})
    assert register.get(job.id) == before


def test_the_same_key_is_the_same_job(register: JobRegister) -> None:
    first, is_new = register.submit(JobRequest("sleep", {}, "h1", "k", "c1", "ops"))
    again, is_new_again = register.submit(JobRequest("sleep", {}, "h1", "k", "c2", "ops"))
    assert (is_new, is_new_again) == (True, False)
    assert again == first
    assert submit(register, "other").id != first.id
    assert submit(register).id != submit(register).id, "without a key each request is its own job"


@pytest.mark.parametrize("status", ["accepted", "running", "successful"])
def test_a_key_is_kept_by_a_job_that_did_not_fail(register: JobRegister, status: Status) -> None:
    job = submit(register, "k")
    register.update(job.id, status)
    assert submit(register, "k").id == job.id
    with pytest.raises(ConflictError, match="'k'"):
        submit(register, "k", body="h2")
    assert len(register.all()) == 1


@pytest.mark.parametrize("status", ["failed", "dismissed"])
@pytest.mark.parametrize("body", ["h1", "h2"])
def test_a_key_is_freed_by_a_job_that_failed(register: JobRegister, status: Status, body: str) -> None:
    job = submit(register, "k")
    register.update(job.id, status, problem=PROBLEM)
    again = submit(register, "k", body=body)
    assert (again.id != job.id, again.status) == (True, "accepted")
    assert submit(register, "k", body=body).id == again.id, "the key is now the second job's"
    assert register.get(job.id).problem == PROBLEM, "the first one is still told of"


def test_a_key_taken_between_look_and_insert_is_found(register: JobRegister, monkeypatch: pytest.MonkeyPatch) -> None:
    look, other = register._by_key, []

    def look_late(connection: Any, key: str, body: str) -> Job | None:
        found = look(connection, key, body)
        if not other:
            other.append("on its way")
            other.append(submit(register, "k").id)
        return found

    monkeypatch.setattr(register, "_by_key", look_late)
    job, is_new = register.submit(JobRequest("sleep", {}, "h1", "k", "c", "ops"))
    assert (job.id, is_new) == (other[1], False)


def test_requests_at_the_same_moment_share_a_job(register: JobRegister) -> None:
    together = threading.Barrier(6)

    def request(_: int) -> tuple[str, bool]:
        together.wait(timeout=10)
        job, is_new = register.submit(JobRequest("sleep", {}, "h1", "k", "c", "ops"))
        return job.id, is_new

    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(request, range(6)))
    assert len({job_id for job_id, _ in answers}) == 1
    assert sum(is_new for _, is_new in answers) == 1, "one of them starts it"


def test_after_a_restart_running_jobs_fail_and_queued_ones_wait_on(url: str) -> None:
    before = JobRegister(url)
    statuses: list[Status] = ["successful", "running", "accepted", "dismissed", "accepted", "running", "failed"]
    made = [submit(before, f"k{k}", number=k) for k in range(len(statuses))]
    for job, status in zip(made, statuses, strict=True):
        before.update(job.id, status)
    untouched = {job.id: before.get(job.id) for job in made if before.get(job.id).status != "running"}
    before.close()

    after = JobRegister(url)
    waiting = after.recover(PROBLEM)
    assert [job.inputs["number"] for job in waiting] == [2, 4], "oldest first"
    assert [job.status for job in waiting] == ["accepted", "accepted"]
    for number in (1, 5):
        lost = after.get(made[number].id)
        assert (lost.status, lost.problem) == ("failed", PROBLEM)
        assert submit(after, f"k{number}").id != lost.id, "its key is free"
    assert {job_id: after.get(job_id) for job_id in untouched} == untouched
    after.close()


def test_an_owner_has_so_many_jobs_at_once_and_no_more(register: JobRegister) -> None:
    def ask(owner: str) -> Job:
        return register.submit(JobRequest("sleep", {}, "h1", None, "c", owner), limit=2)[0]

    first = ask("ops")
    ask("ops")
    with pytest.raises(TooManyJobsError, match=r"'ops' has 2 jobs .* limit is 2"):
        ask("ops")
    ask("science")
    register.update(first.id, "successful")
    ask("ops")


def test_the_same_request_again_is_no_further_job(register: JobRegister) -> None:
    asked = JobRequest("sleep", {}, "h1", "k", "c", "ops")
    assert register.submit(asked, limit=1)[1]
    assert not register.submit(asked, limit=1)[1]


def test_a_register_of_another_release_is_made_anew(url: str) -> None:
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        connection.execute(sa.text("CREATE TABLE jobs (id TEXT PRIMARY KEY, body TEXT)"))
        connection.execute(sa.text("INSERT INTO jobs VALUES ('old', '{}')"))
    engine.dispose()
    opened = JobRegister(url)
    assert opened.all() == []
    assert submit(opened).owner == "ops"
    opened.close()
