"""The artifact root as the loop is told it: a folder of this machine, or the URL of a store (``s3://bucket/prefix``)."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from urllib.parse import urlsplit

from shared.artifacts.disk import to_disk
from shared.artifacts.reference import ArtifactRef
from shared.artifacts.roots import Roots, is_local, local_path, open_root
from shared.artifacts.store import ArtifactStore
from shared.errors import DomainError

ArtifactRoot = str | Path
WORK = "SMOKEGLINT_WORK"
_FETCHED = ".fetched"


def named_root(text: ArtifactRoot) -> str:
    """The root in one spelling: an absolute path, or a URL without a closing slash; DomainError for any other."""
    url = str(text)
    if is_local(url):
        return str(local_path(url).resolve())
    if urlsplit(url).scheme != "s3" or not urlsplit(url).netloc:
        raise DomainError(
            f"'{url}' cannot hold artifacts.", field="root", value=url, accepted="a folder, or s3://bucket/prefix"
        )
    return url.rstrip("/")


def work_folder(root: ArtifactRoot) -> Path:
    """The folder of this machine for what is nobody else's: built cases, logs, Prefect's database, fetched files.

    It is the root itself where that is a folder. Else it lies below ``SMOKEGLINT_WORK`` (``~/.cache/smokeglint``), one
    for each root; losing it loses no artifact.
    """
    url = named_root(root)
    if is_local(url):
        return Path(url)
    base = os.environ.get(WORK, "")
    folder = Path(base) if base else Path.home() / ".cache" / "smokeglint"
    return folder.resolve() / hashlib.sha256(url.encode()).hexdigest()[:16]


def store_of(root: ArtifactRoot, *read_roots: Path) -> ArtifactStore:
    """The artifact store of a root."""
    return ArtifactStore(Roots(named_root(root), tuple(map(str, read_roots))))


def exists(root: ArtifactRoot) -> bool:
    """Whether there is such a folder; of a URL, whether the store has anything under it."""
    fs, path = open_root(named_root(root))
    return bool(fs.exists(path))


def read_bytes(root: ArtifactRoot, path: str) -> bytes:
    """The content of a small file below the root; MissingArtifactError if there is none."""
    location = Roots(named_root(root)).resolve(path)
    content: bytes = location.fs.cat_file(location.path)
    return content


def keep_document(root: ArtifactRoot, path: str, content: bytes) -> None:
    """Write a small file below the root, whole or not at all."""
    url = named_root(root)
    if not is_local(url):
        fs, base = open_root(url)
        fs.pipe_file(f"{base}/{path}", content)  # an object on S3 is there at once or not
        return
    target = Path(url) / path
    target.parent.mkdir(parents=True, exist_ok=True)
    fresh = target.with_suffix(".tmp")
    fresh.write_bytes(content)
    to_disk(fresh)
    fresh.rename(target)
    to_disk(target.parent)


def documents(root: ArtifactRoot, folder: str, suffix: str) -> list[tuple[str, bytes]]:
    """Name and content of each file with this suffix in a folder below the root, by name; none without a folder."""
    fs, base = open_root(named_root(root))
    paths = sorted(fs.glob(f"{base}/{folder}/*{suffix}"))
    return [(path.rsplit("/", 1)[-1], fs.cat_file(path)) for path in paths]


def fetched(store: ArtifactStore, reference: ArtifactRef) -> Path:
    """A path on this machine of a stored file, its hash checked: the file itself, or a copy in the work folder."""
    return store.fetch(reference, work_folder(store.roots.artifact_root) / _FETCHED)
