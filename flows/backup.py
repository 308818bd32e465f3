"""Backup and restore of an artifact root: artifacts, catalogues, decisions, job registers, Prefect's database."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path

from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import MANIFEST
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore
from shared.errors import DomainError

_LEFT_OUT = {".staging", ".logs", ".lock"}  # what a run in progress makes, and nobody needs afterwards
_DATABASES = (".sqlite", ".db")
_LARGEST_UNPACKED = 2 * 10**12


@dataclass(frozen=True)
class Restored:
    """What came back: files in all, steps whose manifest verifies, steps that do not (they are made again)."""

    files: int
    verified: int
    damaged: tuple[str, ...]


def back_up(root: Path, archive: Path) -> int:
    """Write all that is worth keeping below ``root`` into a compressed archive; how many files there were.

    Services may run meanwhile: databases are copied by SQLite's own backup, and a step that is just being written has
    no manifest yet, so it will not count as done. The archive appears whole or not at all.
    """
    if archive.resolve().is_relative_to(root.resolve()):
        raise DomainError("The archive must lie outside the artifact root.", field="to", value=str(archive))
    fresh = archive.with_name(f".{archive.name}.{os.getpid()}")
    count = 0
    try:
        with tarfile.open(fresh, "w:gz", compresslevel=1) as tar, tempfile.TemporaryDirectory() as scratch:
            for path in _worth_keeping(root):
                name = str(path.relative_to(root))
                source = _copy_of_database(path, Path(scratch)) if path.suffix in _DATABASES else path
                try:
                    tar.add(source, name, recursive=False)
                except FileNotFoundError:
                    continue  # removed since it was listed
                count += 1
        fresh.replace(archive)
    finally:
        fresh.unlink(missing_ok=True)
    return count


def _worth_keeping(root: Path) -> list[Path]:
    """Files in order; manifests last, so that none speaks of a file that is not in the archive."""
    found = [
        path
        for path in root.rglob("*")
        if path.is_file()
        and not path.is_symlink()
        and not _LEFT_OUT & set(path.relative_to(root).parts)
        and not path.name.endswith(("-wal", "-shm", "-journal"))
    ]
    return sorted(found, key=lambda path: (path.name == MANIFEST, path))


def _copy_of_database(path: Path, scratch: Path) -> Path:
    copy = scratch / path.name
    copy.unlink(missing_ok=True)
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as source, sqlite3.connect(copy) as target:
        source.backup(target)
    return copy


def restore(archive: Path, root: Path) -> Restored:
    """Unpack a backup into a new artifact root and verify every step of it.

    DomainError: the root is not empty, the file is no backup, or a member would leave the root. Then nothing stays.
    """
    if root.exists() and any(root.iterdir()):
        raise DomainError(f"{root} is not empty; restore into a new folder.", field="root", value=str(root))
    fresh = root.with_name(f".{root.name}.restoring")
    shutil.rmtree(fresh, ignore_errors=True)
    try:
        files = _unpack(archive, fresh)
        if root.exists():
            root.rmdir()
        fresh.rename(root)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    return Restored(files, *_verified(root))


def _unpack(archive: Path, folder: Path) -> int:
    count = size = 0
    try:
        with tarfile.open(archive, "r:gz") as tar:
            for member in tar:
                size += member.size
                if not member.isfile() or size > _LARGEST_UNPACKED:
                    raise DomainError(f"'{member.name}' has no place in a backup.", field="archive", value=member.name)
                tar.extract(member, folder, filter="data")
                count += 1
    except (tarfile.TarError, EOFError, OSError) as error:
        raise DomainError(f"{archive.name} is no whole backup: {error}", field="archive") from error
    return count


def _verified(root: Path) -> tuple[int, tuple[str, ...]]:
    store = ArtifactStore(Roots(str(root)))
    good, damaged = 0, []
    for path in sorted(root.glob(f"*/*/*/*/{MANIFEST}")):
        case, cycle, step, key = path.relative_to(root).parts[:4]
        if store.load(StepAddress(case, cycle, step, key)) is None:
            damaged.append("/".join((case, cycle, step, key)))
        else:
            good += 1
    return good, tuple(damaged)
