"""The store when something goes wrong in the middle: a kill at any operation, a full disk, a clock put back."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import MANIFEST, Manifest, Product
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore, describe_file
from tests.shared.toy_processes import limit_file_size

ADDRESS = StepAddress("case", "cycle-1", "predict-access", "abc123")
CONTENT = {"a.txt": b"first", "b.json": b"{}"}
KILLED = 9


def commit(store: ArtifactStore, address: StepAddress = ADDRESS) -> Manifest:
    with store.staging("access", "job") as staging:
        files = {name: staging / name for name in CONTENT}
        for name, path in files.items():
            path.write_bytes(CONTENT[name])
        described = {name: describe_file(path) for name, path in files.items()}
        head = {"case": address.case, "cycle": address.cycle, "key": address.key}
        made_by = Product(process=address.step, code_version="v")
        manifest = Manifest(**head, product=made_by, inputs=(), parameters={}, outputs={}, files=described)
        return store.commit(address, files, manifest)


def killed_at(operation: int, store: ArtifactStore) -> bool:
    """Commit in a child that dies at its n-th operation on the file system; whether it came that far."""
    child = os.fork()
    if child == 0:
        seen = 0

        def watch(event: str, _: tuple[Any, ...]) -> None:
            nonlocal seen
            if event == "open" or event.startswith(("os.", "shutil.", "tempfile.")):
                seen += 1
                if seen == operation:
                    os._exit(KILLED)

        sys.addaudithook(watch)
        try:
            commit(store)
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == KILLED


@pytest.mark.parametrize("before", ["nothing", "damaged"])
def test_a_commit_killed_at_any_operation_is_whole_or_not_there(tmp_path: Path, before: str) -> None:
    whole = {*CONTENT, MANIFEST}
    operation, outcomes = 1, set()
    while True:
        store = ArtifactStore(Roots(str(tmp_path / f"{operation}")))
        folder = tmp_path / f"{operation}" / ADDRESS.path
        if before == "damaged":
            commit(store)
            (folder / "a.txt").write_bytes(b"damaged")
        if not killed_at(operation, store):
            break
        found = {path.name for path in folder.iterdir()} if folder.exists() else set()
        assert found in (set(), whole)
        done = store.load(ADDRESS) is not None
        assert done or not found or before == "damaged"
        outcomes.add((bool(found), done))
        assert commit(store) == store.load(ADDRESS), "what comes after makes it whole"
        operation += 1
    assert operation > 20
    assert {(False, False), (True, True)} <= outcomes, "killed both before and after the step was done"


@pytest.mark.parametrize("room", [0, 3, 100, 400])
def test_a_full_disk_leaves_nothing_of_the_step(tmp_path: Path, room: int) -> None:
    store = ArtifactStore(Roots(str(tmp_path)))
    with limit_file_size(room), pytest.raises(OSError) as caught:
        commit(store)
    assert caught.value.strerror
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    assert commit(store) == store.load(ADDRESS)


def test_a_full_disk_leaves_a_damaged_step_undone(tmp_path: Path) -> None:
    store = ArtifactStore(Roots(str(tmp_path)))
    commit(store)
    (tmp_path / ADDRESS.path / "b.json").write_bytes(b"damaged")
    with limit_file_size(100), pytest.raises(OSError):
        commit(store)
    assert store.load(ADDRESS) is None


def test_the_last_made_is_the_newest_even_if_the_clock_was_put_back(tmp_path: Path) -> None:
    store = ArtifactStore(Roots(str(tmp_path)))
    earlier = StepAddress("case", "cycle-1", "predict-access", "earlier")
    commit(store, earlier)
    old = tmp_path / earlier.path / MANIFEST
    day_ns = 86_400 * 10**9
    os.utime(old, ns=(old.stat().st_mtime_ns + day_ns,) * 2)  # made before the clock was put back by a day
    commit(store)
    assert (tmp_path / ADDRESS.path / MANIFEST).stat().st_mtime_ns > old.stat().st_mtime_ns
