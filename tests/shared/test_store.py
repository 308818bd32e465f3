"""The artifact store: a step is done if and only if its manifest verifies, here and on a remote file system."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import Manifest, Product
from shared.artifacts.reference import ArtifactRef, media_type
from shared.artifacts.roots import Roots
from shared.artifacts.store import STAGING, ArtifactStore, describe_file
from shared.errors import DomainError, ForbiddenReferenceError, MissingArtifactError, TamperedArtifactError
from tests.shared.servers import S3_ENVIRONMENT, s3_server

ADDRESS = StepAddress("case", "cycle-1", "predict-access", "abc123")
CONTENT = {"a.txt": b"first", "b.json": b"{}"}


@pytest.fixture(scope="module")
def s3_url() -> Iterator[str]:
    with s3_server() as url:
        yield url


@pytest.fixture(params=["file", "memory", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ArtifactStore]:
    """A store on this machine, one on another file system, and one on a real S3 server."""
    if request.param == "file":
        yield ArtifactStore(Roots(str(tmp_path / "artifacts")))
        return
    if request.param == "s3":
        settings = {**S3_ENVIRONMENT, "AWS_ENDPOINT_URL": request.getfixturevalue("s3_url")}
        for name, value in settings.items():
            monkeypatch.setenv(name, value)
        bucket = f"bucket-{uuid.uuid4().hex}"
        fsspec.filesystem("s3", skip_instance_cache=True).mkdir(bucket)
        yield ArtifactStore(Roots(f"s3://{bucket}/artifacts"))
        return
    folder = f"/store-{uuid.uuid4().hex}"
    yield ArtifactStore(Roots(f"memory:/{folder}"))
    memory = fsspec.filesystem("memory")
    if memory.exists(folder):
        memory.rm(folder, recursive=True)


def paths(store: ArtifactStore) -> set[str]:
    """Every file of the store, below its root."""
    root = store._folder(ADDRESS).removesuffix(ADDRESS.path)
    return {path.removeprefix(root) for path in store._fs.find(root)}


def manifest_of(files: dict[str, Path], address: StepAddress = ADDRESS) -> Manifest:
    return Manifest(
        case=address.case,
        cycle=address.cycle,
        key=address.key,
        product=Product(process=address.step, code_version="v"),
        inputs=(),
        parameters={},
        outputs={},
        files={name: describe_file(path) for name, path in files.items()},
    )


def commit(store: ArtifactStore, address: StepAddress = ADDRESS, content: dict[str, bytes] = CONTENT) -> Manifest:
    with store.staging("access", "job") as staging:
        files = {name: staging / name for name in content}
        for name, path in files.items():
            path.write_bytes(content[name])
        return store.commit(address, files, manifest_of(files, address))


def folder_of(store: ArtifactStore, address: StepAddress = ADDRESS) -> str:
    return store._folder(address)


def test_a_committed_step_is_done(store: ArtifactStore) -> None:
    assert store.load(ADDRESS) is None
    manifest = commit(store)
    assert store.load(ADDRESS) == manifest
    assert store.load(StepAddress("case", "cycle-1", "predict-access", "other")) is None
    expected = {f"{ADDRESS.path}/{name}" for name in (*CONTENT, "manifest.json")}
    assert paths(store) == expected, "nothing is left in staging"
    assert manifest.files["a.txt"].sha256 == hashlib.sha256(b"first").hexdigest()
    assert (manifest.files["a.txt"].size, manifest.files["a.txt"].type) == (5, "text/plain")


def test_what_another_process_finished_is_seen(store: ArtifactStore) -> None:
    assert list(store.manifests("case")) == [] and store.load(ADDRESS) is None
    other = ArtifactStore(store.roots)
    if "file" not in store._fs.protocol and "memory" not in store._fs.protocol:
        other._fs = type(store._fs)(skip_instance_cache=True, use_listings_cache=False)
        assert other._fs is not store._fs
    manifest = commit(other)
    assert store.load(ADDRESS) == manifest and list(store.manifests("case")) == [manifest]


def test_its_files_are_reached_by_reference(store: ArtifactStore) -> None:
    manifest = commit(store)
    reference = store.reference(ADDRESS, "a.txt", manifest.files["a.txt"])
    location, digest = store.open_reference(reference)
    assert digest == reference.sha256
    assert location.fs.cat_file(location.path) == b"first"
    assert store.roots.relative(location) == f"{ADDRESS.path}/a.txt"
    assert store.product_of(location) == manifest.product
    by_path, _ = store.open_reference(ArtifactRef(href=f"{ADDRESS.path}/a.txt"))
    assert by_path.path == location.path


@pytest.mark.parametrize("name", ["a.txt", "b.json"])
def test_a_tampered_file_undoes_the_step(store: ArtifactStore, name: str) -> None:
    manifest = commit(store)
    store._fs.pipe_file(f"{folder_of(store)}/{name}", b"x" * len(CONTENT[name]))
    assert store.load(ADDRESS) is None
    with pytest.raises(TamperedArtifactError) as caught:
        store.open_reference(store.reference(ADDRESS, name, manifest.files[name]))
    assert caught.value.field == "sha256"
    assert name in caught.value.message
    assert commit(store) == manifest
    assert store.load(ADDRESS) == manifest, "it can be done again"


def test_a_lost_file_undoes_the_step(store: ArtifactStore) -> None:
    commit(store)
    store._fs.rm(f"{folder_of(store)}/a.txt")
    assert store.load(ADDRESS) is None


@pytest.mark.parametrize("content", [b"", b"{", b"{}", b"\xff\xfe", b'{"case": "case", "made_at": 1}'])
def test_a_broken_manifest_is_none(store: ArtifactStore, content: bytes) -> None:
    commit(store)
    store._fs.pipe_file(f"{folder_of(store)}/manifest.json", content)
    assert store.load(ADDRESS) is None
    assert list(store.manifests("case")) == []


def test_without_its_manifest_a_step_is_not_done(store: ArtifactStore) -> None:
    commit(store)
    store._fs.rm(f"{folder_of(store)}/manifest.json")
    assert store.load(ADDRESS) is None


def test_a_step_that_another_worker_finished_stays_as_it_is(store: ArtifactStore) -> None:
    first = commit(store)
    assert commit(store, content={"a.txt": b"new", "b.json": b"[]"}) == first
    assert store.load(ADDRESS) == first
    assert store._fs.cat_file(f"{folder_of(store)}/a.txt") == CONTENT["a.txt"]


@pytest.mark.parametrize("store", ["memory", "s3"], indirect=True)
def test_a_remote_commit_cut_short_leaves_no_manifest(store: ArtifactStore, monkeypatch: pytest.MonkeyPatch) -> None:
    commit(store)
    store._fs.pipe_file(f"{folder_of(store)}/b.json", b"damaged")
    put, seen = store._put, []

    def fail_at_second(staged: Path, target: str) -> None:
        seen.append(target)
        if len(seen) == 2:
            raise OSError("disk full")
        put(staged, target)

    monkeypatch.setattr(store, "_put", fail_at_second)
    with pytest.raises(OSError, match="disk full"):
        commit(store, content={"a.txt": b"new", "b.json": b"[]"})
    assert store.load(ADDRESS) is None
    assert f"{ADDRESS.path}/manifest.json" not in paths(store), "the old one is gone before the first new file"
    assert not any(STAGING in path for path in paths(store))


@pytest.mark.parametrize("store", ["memory", "s3"], indirect=True)
def test_on_a_remote_store_the_manifest_is_put_in_place_last(
    store: ArtifactStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    put, order = store._put, []
    monkeypatch.setattr(store, "_put", lambda staged, target: (order.append(target), put(staged, target)))
    commit(store)
    assert [target.rsplit("/", 1)[1] for target in order] == ["a.txt", "b.json", "manifest.json"]


def test_manifests_of_a_case_come_in_order(store: ArtifactStore) -> None:
    for case, cycle, key in [("case", "2", "a"), ("case", "1", "b"), ("other", "1", "c")]:
        commit(store, StepAddress(case, cycle, "predict-access", key))
    assert [manifest.key for manifest in store.manifests("case")] == ["b", "a"]


def test_a_sweep_removes_what_is_not_done_and_nothing_else(
    store: ArtifactStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shared.artifacts.store.UPLOAD_PATIENCE_S", -60.0)  # a remote clock may differ a little
    done = commit(store)
    undone = StepAddress("case", "cycle-1", "predict-access", "half")
    of_others = StepAddress("case", "cycle-1", "check-plan", "half")
    root = folder_of(store).removesuffix("/" + ADDRESS.path)
    kept = {f"{of_others.path}/a.txt", f"{STAGING}/planning/job/a.txt", "case/targets.parquet", ".jobs/access.sqlite"}
    for path in (*kept, f"{undone.path}/a.txt", f"{STAGING}/access/job/a.txt"):
        store._fs.makedirs(f"{root}/{path}".rsplit("/", 1)[0], exist_ok=True)
        store._fs.pipe_file(f"{root}/{path}", b"x")
    assert store.sweep("access", ["predict-access"]) == 2
    assert paths(store) == kept | {f"{ADDRESS.path}/{name}" for name in (*CONTENT, "manifest.json")}
    assert store.load(ADDRESS) == done
    assert store.sweep("access", ["predict-access"]) == 0


def test_a_sweep_spares_what_is_being_uploaded(store: ArtifactStore) -> None:
    path = f"{folder_of(store).removesuffix('/' + ADDRESS.path)}/case/cycle-1/predict-access/half/a.txt"
    store._fs.makedirs(path.rsplit("/", 1)[0], exist_ok=True)
    store._fs.pipe_file(path, b"x")
    assert store.sweep("access", ["predict-access"]) == (1 if "file" in store._fs.protocol else 0)


def test_staging_is_gone_after_a_fault(store: ArtifactStore) -> None:
    with pytest.raises(RuntimeError, match="broken"), store.staging("access", "job") as staging:
        (staging / "half.txt").write_text("half")
        raise RuntimeError("broken")
    assert not staging.exists()
    assert paths(store) == set()


def test_a_store_says_whether_it_can_be_written(store: ArtifactStore, monkeypatch: pytest.MonkeyPatch) -> None:
    assert store.writable()
    assert paths(store) == set()

    def refuse(*_: object) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(store._fs, "pipe_file", refuse)
    assert not store.writable()


def test_discard_removes_what_a_killed_job_staged(store: ArtifactStore) -> None:
    killed, running = uuid.uuid4().hex, uuid.uuid4().hex
    opened = [store.staging("access", job) for job in (killed, running)]
    of_killed, of_running = [staging.__enter__() for staging in opened]
    (of_killed / "half.txt").write_text("half")
    store.discard("access", killed)
    store.discard("access", uuid.uuid4().hex)
    assert (of_killed.exists(), of_running.exists()) == (False, True)
    for staging in opened:
        staging.__exit__(None, None, None)
    assert not of_running.exists()


@pytest.mark.parametrize("segment", ["case", "cycle", "step", "key"])
@pytest.mark.parametrize("bad", ["../x", "..", ".", "", "a/b", "/etc", ".hidden", "-x", "a b", "a\n", "a\0", "x" * 121])
def test_a_segment_that_leads_elsewhere_is_refused(segment: str, bad: str) -> None:
    with pytest.raises(DomainError) as caught:
        StepAddress(**{"case": "a", "cycle": "b", "step": "c", "key": "d", segment: bad})
    assert caught.value.field == segment


def test_usual_segments_are_accepted() -> None:
    address = StepAddress("tiny", "2024-07-01T00.00Z", "predict-access", "x" * 120)
    assert address.path == "tiny/2024-07-01T00.00Z/predict-access/" + "x" * 120


@pytest.mark.parametrize(
    "href",
    [
        "../secret.txt",
        "case/../../secret.txt",
        "/etc/passwd",
        "file:///etc/passwd",
        "file:///etc/%70asswd",
        "file://elsewhere/etc/passwd",
        "http://example.org/a.txt",
        "http://[bad",
        "memory://secret/a.txt",
        "s3://bucket/a.txt",
        "link.txt",
        "folder-link/secret.txt",
        "loop",
        "nul\0byte",
    ],
)
def test_nothing_outside_the_roots_is_read(tmp_path: Path, href: str) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (tmp_path / "secret.txt").write_text("secret")
    (root / "link.txt").symlink_to(tmp_path / "secret.txt")
    (root / "folder-link").symlink_to(tmp_path)
    (root / "loop").symlink_to(root / "loop")
    with pytest.raises(ForbiddenReferenceError) as caught:
        Roots(str(root)).resolve(href)
    assert (caught.value.field, caught.value.value) == ("href", href)


def test_a_folder_beside_the_root_is_outside_it(tmp_path: Path) -> None:
    for name in ("root", "root-2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.txt").write_text(name)
    with pytest.raises(ForbiddenReferenceError):
        Roots(str(tmp_path / "root")).resolve(str(tmp_path / "root-2" / "a.txt"))


def test_a_symlink_within_the_roots_is_followed(tmp_path: Path) -> None:
    (tmp_path / "root").mkdir()
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a b.txt").write_text("a")
    (tmp_path / "root" / "link.txt").symlink_to(tmp_path / "data" / "a b.txt")
    roots = Roots((tmp_path / "root").as_uri(), (str(tmp_path / "data"),))
    for href in ("link.txt", (tmp_path / "data" / "a b.txt").as_uri(), str(tmp_path / "data" / "a b.txt")):
        location = roots.resolve(href)
        assert location.local == tmp_path / "data" / "a b.txt"
        assert roots.relative(location) == "external:a b.txt"


@pytest.mark.parametrize(
    "href",
    [
        "../other/a.txt",
        "case/../../other/a.txt",
        "memory://root/../other/a.txt",
        "memory://other/a.txt",
        "memory://root-2/a.txt",
        "s3://root/a.txt",
        "file:///etc/passwd",
    ],
)
def test_nothing_outside_a_remote_root_is_read(href: str) -> None:
    memory = fsspec.filesystem("memory")
    for path in ("/root/case/b.txt", "/other/a.txt", "/root-2/a.txt"):
        memory.pipe_file(path, b"x")
    roots = Roots("memory://root")
    try:
        assert roots.resolve("case/b.txt").path == roots.resolve("memory://root/case/b.txt").path
        assert roots.resolve("case/b.txt").local is None
        with pytest.raises(ForbiddenReferenceError):
            roots.resolve(href)
    finally:
        for folder in ("/root", "/other", "/root-2"):
            memory.rm(folder, recursive=True)


@pytest.mark.parametrize("href", ["none.txt", "case", "."])
def test_what_is_no_file_is_missing(tmp_path: Path, href: str) -> None:
    (tmp_path / "case").mkdir()
    with pytest.raises(MissingArtifactError, match="no file"):
        Roots(str(tmp_path)).resolve(href)


def test_media_types_follow_the_suffix() -> None:
    assert media_type("a.PARQUET") == "application/vnd.apache.parquet"
    assert media_type("tar.nc") == "application/x-netcdf"
    assert media_type("manifest") == media_type("a.bin") == "application/octet-stream"


def test_a_file_of_the_work_folder_is_told_like_one_from_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "root" / ".cases").mkdir(parents=True)
    (tmp_path / "root" / ".cases" / "case.toml").write_text("a")
    roots = Roots(str(tmp_path / "root"))
    assert roots.relative(roots.resolve(".cases/case.toml")) == "external:case.toml"  # as where the root is on S3
