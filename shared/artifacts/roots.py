"""Where services may read and write: configured roots, and nothing outside them."""

from __future__ import annotations

import hashlib
import posixpath
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

import fsspec
from fsspec.spec import AbstractFileSystem

from shared.errors import ForbiddenReferenceError, MissingArtifactError

_BLOCK = 1 << 20


def is_local(url: str) -> bool:
    """Whether a root is a folder of this machine."""
    return urlsplit(url).scheme in ("", "file")


def local_path(url: str) -> Path:
    """The folder that a ``file://`` URL or plain path names."""
    return Path(unquote(urlsplit(url).path) if urlsplit(url).scheme == "file" else url)


def open_root(url: str) -> tuple[AbstractFileSystem, str]:
    """The file system of a remote root and the root's path there.

    Listings are not kept: other processes write under the same root, and what they finished must be seen.
    """
    fs, path = fsspec.core.url_to_fs(url, use_listings_cache=False)
    return fs, str(path)


@dataclass(frozen=True)
class Location:
    """A resolved file: its file system and its path there."""

    fs: AbstractFileSystem
    path: str

    @property
    def local(self) -> Path | None:
        """The path on this machine, or None if the file lies elsewhere."""
        return Path(self.path) if "file" in _protocols(self.fs) else None

    def sha256(self) -> str:
        """Hash of the content, read in blocks; on S3 an object is read again only once its entity tag has changed."""
        if self.local is None and (tag := self.fs.info(self.path).get("ETag")):
            return _digest_of_version(self.fs, self.path, tag)
        return _digest(self.fs, self.path)


def _digest(fs: AbstractFileSystem, path: str) -> str:
    digest = hashlib.sha256()
    with fs.open(path, "rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


@lru_cache(maxsize=100_000)
def _digest_of_version(fs: AbstractFileSystem, path: str, tag: str) -> str:
    """The hash of an object that bears this entity tag: S3 gives other content another one."""
    return _digest(fs, path)


@dataclass(frozen=True)
class Roots:
    """The artifact root (read and write) and further roots that may be read."""

    artifact_root: str
    read_roots: tuple[str, ...] = ()

    def resolve(self, href: str) -> Location:
        """The file behind a reference, symlinks resolved.

        Raises ForbiddenReferenceError if it leads outside every root, MissingArtifactError if there is no such file.
        """
        try:
            location = self._resolve_local(href) if self._means_local(href) else self._resolve_remote(href)
        except (ValueError, RuntimeError) as error:  # no URL at all, a null byte, a loop of symlinks
            raise self._forbidden(href) from error
        if not location.fs.isfile(location.path):
            raise MissingArtifactError(
                f"There is no file '{href}'.",
                field="href",
                value=href,
                accepted="an existing file under an allowed root",
            )
        return location

    def relative(self, location: Location) -> str:
        """The path below the artifact root, with ``external:`` and the bare name for files of other roots.

        A hidden folder of the root (``.cases``) counts as another: where the root is on S3, it lies on some machine,
        and the record of a step must be the same in both.
        """
        root = self._root_path()
        if location.path.startswith(root + "/") and not location.path.startswith(root + "/."):
            return location.path[len(root) + 1 :]
        return "external:" + posixpath.basename(location.path)

    def _root_path(self) -> str:
        if is_local(self.artifact_root):
            return str(local_path(self.artifact_root).resolve())
        return str(open_root(self.artifact_root)[1]).rstrip("/")

    def _means_local(self, href: str) -> bool:
        scheme = urlsplit(href).scheme
        return scheme == "file" or (scheme == "" and is_local(self.artifact_root))

    def _resolve_local(self, href: str) -> Location:
        if urlsplit(href).netloc not in ("", "localhost"):
            raise self._forbidden(href)
        path = local_path(href)
        if not path.is_absolute():
            path = local_path(self.artifact_root) / path
        real = path.resolve()
        allowed = [local_path(root).resolve() for root in (self.artifact_root, *self.read_roots) if is_local(root)]
        if not any(real.is_relative_to(root) for root in allowed):
            raise self._forbidden(href)
        return Location(fsspec.filesystem("file"), str(real))

    def _resolve_remote(self, href: str) -> Location:
        url = href if urlsplit(href).scheme else self.artifact_root.rstrip("/") + "/" + href
        for root in (self.artifact_root, *self.read_roots):
            if is_local(root) or urlsplit(root).scheme != urlsplit(url).scheme:
                continue
            fs, root_path = open_root(root)
            path = posixpath.normpath(fs._strip_protocol(url))
            if path.startswith(str(root_path).rstrip("/") + "/"):
                return Location(fs, path)
        raise self._forbidden(href)

    def _forbidden(self, href: str) -> ForbiddenReferenceError:
        return ForbiddenReferenceError(
            f"The reference '{href}' leads outside the folders that this service may read.",
            field="href",
            value=href,
            accepted="a file under the artifact root or one of the configured read roots",
        )


def _protocols(fs: AbstractFileSystem) -> tuple[str, ...]:
    return (fs.protocol,) if isinstance(fs.protocol, str) else tuple(fs.protocol)
