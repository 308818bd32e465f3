"""What a root may be, where its machine's own files go, and that one loop at a time works on it, here and on S3."""

from __future__ import annotations

import hashlib
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from flows.root import WORK, documents, exists, fetched, keep_document, named_root, read_bytes, store_of, work_folder
from flows.root_lock import Lease, only_run
from shared.artifacts.reference import ArtifactRef
from shared.errors import DomainError, MissingArtifactError, SmokeglintError, TamperedArtifactError
from tests.shared.servers import S3_ENVIRONMENT, s3_server

LEASE_S, RENEW_S = 1.0, 0.2


@pytest.fixture(scope="module")
def s3_url() -> Iterator[str]:
    with s3_server() as url:
        yield url


@pytest.fixture
def s3_root(s3_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    for name, value in (S3_ENVIRONMENT | {"AWS_ENDPOINT_URL": s3_url, WORK: str(tmp_path / "work")}).items():
        monkeypatch.setenv(name, value)
    fsspec.get_filesystem_class("s3").clear_instance_cache()  # of other tests, with another server
    bucket = f"bucket-{uuid.uuid4().hex}"
    fsspec.filesystem("s3").mkdir(bucket)
    yield f"s3://{bucket}/artifacts"
    fsspec.get_filesystem_class("s3").clear_instance_cache()


@pytest.fixture(params=["folder", "s3"])
def root(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return str(tmp_path / "root") if request.param == "folder" else request.getfixturevalue("s3_root")


def lease(root: str) -> Lease:
    return Lease(root, LEASE_S, RENEW_S)


def test_a_root_is_a_folder_or_a_place_on_s3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(WORK, str(tmp_path / "work"))
    assert named_root("artifacts") == named_root(tmp_path / "artifacts") == str(tmp_path / "artifacts")
    assert work_folder("artifacts") == tmp_path / "artifacts"
    assert named_root("s3://bucket/a/") == "s3://bucket/a"
    folders = {work_folder(root) for root in ("s3://bucket/a", "s3://bucket/a/", "s3://bucket/b")}
    assert len(folders) == 2 and {folder.parent for folder in folders} == {tmp_path / "work"}
    for wrong in ("http://bucket/a", "s3://", "gs://bucket"):
        with pytest.raises(DomainError, match="cannot hold artifacts"):
            named_root(wrong)


def test_small_files_are_kept_and_listed(root: str) -> None:
    assert not exists(root) and documents(root, "case/.decisions", ".json") == []
    for name, content in (("b.json", b"2"), ("a.json", b"1"), ("a.txt", b"3"), ("b.json", b"4")):
        keep_document(root, f"case/.decisions/{name}", content)
    assert documents(root, "case/.decisions", ".json") == [("a.json", b"1"), ("b.json", b"4")]
    assert exists(root) and read_bytes(root, "case/.decisions/a.txt") == b"3"
    assert store_of(root).cases() == ["case"]
    with pytest.raises(MissingArtifactError):
        read_bytes(root, "case/none.json")


def test_a_fetched_file_keeps_its_name_and_is_what_it_should_be(root: str) -> None:
    keep_document(root, "case/a.txt", b"first")
    path = fetched(store_of(root), ArtifactRef(href="case/a.txt"))
    assert (path.name, path.read_bytes()) == ("a.txt", b"first")
    digest = hashlib.sha256(b"first").hexdigest()
    again = fetched(store_of(root), ArtifactRef(href="case/a.txt", sha256=digest))
    assert again == path, "one copy for each content"
    with pytest.raises(TamperedArtifactError):
        fetched(store_of(root), ArtifactRef(href="case/a.txt", sha256=64 * "0"))


def test_only_one_of_many_takes_the_lock(s3_root: str) -> None:
    held, most, turns = 0, 0, 0
    guard = threading.Lock()

    def work() -> None:
        nonlocal held, most, turns
        with lease(s3_root).held(wait_s=60.0):
            with guard:
                held, turns = held + 1, turns + 1
                most = max(most, held)
            time.sleep(0.02)
            with guard:
                held -= 1

    workers = [threading.Thread(target=work) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert (most, turns) == (1, 4)
    assert not exists(s3_root), "the last one removed it"


def test_a_lock_that_is_renewed_refuses_another_run(s3_root: str) -> None:
    with lease(s3_root).held(0.0), pytest.raises(DomainError, match="Another run works on"), lease(s3_root).held(0.0):
        pass
    with only_run(s3_root):
        assert exists(f"{s3_root}/.lock")


def test_the_lock_of_a_killed_run_is_taken_over(s3_root: str) -> None:
    lease(s3_root)._take(0.0)  # and never renewed
    begun = time.monotonic()
    with lease(s3_root).held(0.0):
        assert time.monotonic() - begun >= LEASE_S


def test_a_run_that_lost_its_lock_ends_and_leaves_the_new_one(s3_root: str) -> None:
    with pytest.raises(SmokeglintError, match="could not be renewed"), lease(s3_root).held(0.0):
        keep_document(s3_root, ".lock", b'{"id": "of another"}')
        for _ in range(600):
            time.sleep(0.05)
    assert b"of another" in read_bytes(s3_root, ".lock")


@pytest.mark.parametrize("fault", [RuntimeError("no answer"), OSError("refused")])
def test_a_run_whose_store_is_away_for_a_lease_ends(
    s3_root: str, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    def away(**_: str) -> bool:
        raise fault

    held = lease(s3_root)
    with pytest.raises(SmokeglintError, match="could not be renewed"), held.held(0.0):
        monkeypatch.setattr(held, "_put", away)
        for _ in range(600):
            time.sleep(0.05)
