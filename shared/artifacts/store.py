"""The artifact store: ``{root}/{case}/{cycle}/{step}/{key}/{name}``, with a manifest put in place last."""

from __future__ import annotations

import contextlib
import posixpath
import shutil
import tempfile
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import fsspec
from pydantic import ValidationError

from shared.artifacts.address import StepAddress
from shared.artifacts.disk import later_than_siblings, to_disk
from shared.artifacts.manifest import MANIFEST, FileEntry, Manifest, Product
from shared.artifacts.reference import ArtifactRef, media_type
from shared.artifacts.roots import Location, Roots, is_local, local_path, open_root
from shared.errors import SmokeglintError, TamperedArtifactError

STAGING = ".staging"
UPLOAD_PATIENCE_S = 3600.0


class ArtifactStore:
    """Reads references and commits finished steps; all paths stay under the configured roots."""

    def __init__(self, roots: Roots) -> None:
        self.roots = roots
        if is_local(roots.artifact_root):
            local_path(roots.artifact_root).mkdir(parents=True, exist_ok=True)
            self._fs, self._root = fsspec.filesystem("file"), str(local_path(roots.artifact_root).resolve())
        else:
            self._fs, self._root = open_root(roots.artifact_root)

    # Reading

    def open_reference(self, reference: ArtifactRef) -> tuple[Location, str]:
        """The file behind a reference and its hash; TamperedArtifactError if the hash is not the one it states."""
        location = self.roots.resolve(reference.href)
        return location, _checked(reference, location.sha256())

    def fetch(self, reference: ArtifactRef, into: Path) -> Path:
        """A path on this machine of the file behind a reference, its hash checked.

        A file that lies elsewhere is copied below the folder ``into``, under its own name, once for each content.
        """
        location = self.roots.resolve(reference.href)
        if location.local is not None:
            if reference.sha256:
                _checked(reference, location.sha256())
            return location.local
        kept = into / reference.sha256 / reference.name if reference.sha256 else into
        if kept.is_file() and Location(fsspec.filesystem("file"), str(kept)).sha256() == reference.sha256:
            return kept
        into.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=into) as folder:
            fresh = Path(folder) / "fresh"
            location.fs.get_file(location.path, str(fresh))
            digest = _checked(reference, Location(fsspec.filesystem("file"), str(fresh)).sha256())
            (into / digest).mkdir(exist_ok=True)
            return fresh.replace(into / digest / reference.name)

    def product_of(self, location: Location) -> Product | None:
        """The product attributes of a stored file, from the manifest beside it; None for a file without one."""
        folder, name = posixpath.split(location.path)
        manifest = self._read_manifest(location.fs, folder)
        return manifest.product_of(name) if manifest and name in manifest.files else None

    def load(self, address: StepAddress) -> Manifest | None:
        """The manifest of a finished step whose files all verify; None if the step is not done."""
        folder = self._folder(address)
        manifest = self._read_manifest(self._fs, folder)
        if manifest is None:
            return None
        for name, entry in manifest.files.items():
            location = Location(self._fs, posixpath.join(folder, name))
            if not self._fs.isfile(location.path) or location.sha256() != entry.sha256:
                return None
        return manifest

    def record(self, address: StepAddress) -> Manifest | None:
        """What a step says of itself, its files not verified; None if it has no readable manifest."""
        return self._read_manifest(self._fs, self._folder(address))

    def reference(self, address: StepAddress, name: str, entry: FileEntry) -> ArtifactRef:
        """The reference to one file of a finished step."""
        return ArtifactRef(href=self._url(address, name), type=entry.type, sha256=entry.sha256)

    def manifests(self, case: str) -> Iterator[Manifest]:
        """Every readable manifest of a case, in the order of its path."""
        return (manifest for manifest, _ in self.dated_manifests(case))

    def addresses(self, case: str) -> list[StepAddress]:
        """Where the steps of a case lie that have a manifest, readable or not, in the order of their paths."""
        return [StepAddress(*posixpath.dirname(path).split("/")[-4:]) for path in self._manifest_files(case)]

    def dated_manifests(self, case: str) -> Iterator[tuple[Manifest, float]]:
        """Every readable manifest of a case and when it was put in place (s since 1970), in the order of its path."""
        files = self._manifest_files(case)
        # Elsewhere many are asked for at once: one after the other, each would take a whole answer's time.
        contents = self._fs.cat([*files], on_error="omit") if files and not is_local(self.roots.artifact_root) else {}
        for path, facts in files.items():
            content = contents.get(path)
            manifest = _parsed(content) if content else self._read_manifest(self._fs, posixpath.dirname(path))
            if manifest is not None:
                yield manifest, _written(facts)

    def cases(self) -> list[str]:
        """The names of the folders below the root that may hold a case."""
        folders = self._fs.glob(posixpath.join(self._root, "*"))
        names = {posixpath.basename(path.rstrip("/")) for path in folders if self._fs.isdir(path)}
        return sorted(name for name in names if not name.startswith("."))

    # Writing

    @contextlib.contextmanager
    def staging(self, owner: str, name: str) -> Iterator[Path]:
        """A private folder on this machine for the files of one job; gone afterwards, whatever happened."""
        if is_local(self.roots.artifact_root):
            folder = Path(self._root) / STAGING / owner / name
            folder.mkdir(parents=True, exist_ok=True)
        else:
            folder = Path(tempfile.mkdtemp(prefix=_prefix(owner, name)))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def discard(self, owner: str, name: str) -> None:
        """Remove the staging folder of a job whose worker was killed."""
        if is_local(self.roots.artifact_root):
            shutil.rmtree(Path(self._root) / STAGING / owner / name, ignore_errors=True)
        else:
            for folder in Path(tempfile.gettempdir()).glob(_prefix(owner, name) + "*"):
                shutil.rmtree(folder, ignore_errors=True)

    def commit(self, address: StepAddress, files: dict[str, Path], manifest: Manifest) -> Manifest:
        """Put staged files and their manifest into place. Until the manifest is there, the step is not done.

        On this machine the step's folder appears at once, by one rename: nobody ever sees a part of it, whatever is
        killed when. On a remote file system the files go one by one, the manifest last.
        A step that another worker has finished meanwhile is left as it is: references to it are already in use.
        SmokeglintError: there is no file to commit.
        """
        if not files:
            raise SmokeglintError(f"The step {address} made no file, so there is nothing to commit.")
        finished = self.load(address)
        if finished is not None:
            return finished
        staging = next(iter(files.values())).parent
        target = self._folder(address)
        if Location(self._fs, target).local is None:
            self._upload(target, files, manifest)
            return manifest
        fresh = Path(tempfile.mkdtemp(prefix=".commit-", dir=staging))
        for name, staged in files.items():
            staged.replace(fresh / name)
        (fresh / MANIFEST).write_bytes(manifest.to_bytes())
        for path in (*fresh.iterdir(), fresh):
            to_disk(path)
        return self._move_in(fresh, Path(target), address, manifest)

    def _move_in(self, fresh: Path, target: Path, address: StepAddress, manifest: Manifest) -> Manifest:
        """Rename the finished folder into place; an old one that does not verify goes away with the staging folder."""
        fresh.chmod(0o755)
        target.parent.mkdir(parents=True, exist_ok=True)
        later_than_siblings(fresh / MANIFEST, target.parent)
        try:
            fresh.rename(target)
        except OSError:  # there is a folder already: another worker's, finished just now, or a damaged one
            finished = self.load(address)
            if finished is not None:
                return finished
            target.rename(Path(tempfile.mkdtemp(prefix=".damaged-", dir=fresh.parent)) / target.name)
            fresh.rename(target)
        to_disk(target.parent)
        return manifest

    def _upload(self, folder: str, files: dict[str, Path], manifest: Manifest) -> None:
        self._fs.makedirs(folder, exist_ok=True)
        target = posixpath.join(folder, MANIFEST)
        if self._fs.exists(target):
            self._fs.rm(target)  # it did not verify, else the step would not have run again
        for name, staged in files.items():
            self._put(staged, posixpath.join(folder, name))
        last = next(iter(files.values())).with_name(f".{MANIFEST}")
        last.write_bytes(manifest.to_bytes())
        self._put(last, target)

    def _put(self, staged: Path, target: str) -> None:
        self._fs.put_file(str(staged), target)

    def forget(self, address: StepAddress) -> None:
        """Remove the manifest of a step, so that it is made again."""
        self._fs.rm(posixpath.join(self._folder(address), MANIFEST))

    def sweep(self, owner: str, steps: Iterable[str]) -> int:
        """Remove what a killed owner left: its staging folder, and folders of its steps without a manifest.

        Of a remote root only folders that nobody has written to for ``UPLOAD_PATIENCE_S``; staging folders lie in
        this machine's temporary folder then, and are left to it.
        """
        removed = 0
        staging = posixpath.join(self._root, STAGING, owner)
        if self._fs.exists(staging):
            self._fs.rm(staging, recursive=True)
            removed += 1
        for folder in self._unfinished(steps):
            self._fs.rm(folder, recursive=True)
            removed += 1
        return removed

    def _unfinished(self, steps: Iterable[str]) -> list[str]:
        """Folders of these steps without a manifest."""
        if is_local(self.roots.artifact_root):
            folders = [f for step in steps for f in self._fs.glob(posixpath.join(self._root, "*", "*", step, "*"))]
            return [f for f in folders if self._fs.isdir(f) and not self._fs.exists(posixpath.join(f, MANIFEST))]
        kept: dict[str, bool] = {}  # one listing of everything: asking for each folder would take a request each
        wanted, now = set(steps), time.time()
        for path, facts in self._fs.find(self._root, detail=True).items():
            parts = path.removeprefix(self._root + "/").split("/")
            if len(parts) == 5 and parts[2] in wanted:
                folder = posixpath.dirname(path)
                # Another process, elsewhere perhaps, may be at the upload just now.
                spare = parts[4] == MANIFEST or now - _written(facts) < UPLOAD_PATIENCE_S
                kept[folder] = kept.get(folder, False) or spare
        return [folder for folder, spare in kept.items() if not spare]

    def writable(self) -> bool:
        """Whether a file can be written and removed below the root."""
        probe = posixpath.join(self._root, STAGING, f"probe-{uuid.uuid4().hex}")  # several may ask at once
        try:
            self._fs.makedirs(posixpath.dirname(probe), exist_ok=True)
            self._fs.pipe_file(probe, b"")
            self._fs.rm(probe)
        except Exception:  # a disk or a server that fails: each file system has errors of its own
            return False
        return True

    def _folder(self, address: StepAddress) -> str:
        return posixpath.join(self._root, address.path)

    def _manifest_files(self, case: str) -> dict[str, dict[str, Any]]:
        """What the file system tells of each manifest of a case, in the order of their paths."""
        folder = posixpath.join(self._root, case)
        if is_local(self.roots.artifact_root):
            found = self._fs.glob(posixpath.join(folder, "*", "*", "*", MANIFEST), detail=True)
        else:  # one flat listing: a pattern would list each folder by itself
            listed = self._fs.find(folder, detail=True)
            found = {p: facts for p, facts in listed.items() if p.count("/") == folder.count("/") + 4}
        return {path: found[path] for path in sorted(found) if path.endswith("/" + MANIFEST)}

    def _url(self, address: StepAddress, name: str) -> str:
        path = posixpath.join(self._root, address.path, name)
        return Path(path).as_uri() if is_local(self.roots.artifact_root) else str(self._fs.unstrip_protocol(path))

    def _read_manifest(self, fs: Any, folder: str) -> Manifest | None:
        path = posixpath.join(folder, MANIFEST)
        if not fs.exists(path):
            return None
        return _parsed(fs.cat_file(path))


def _parsed(content: bytes) -> Manifest | None:
    try:
        return Manifest.model_validate_json(content)
    except ValidationError:
        return None


def _checked(reference: ArtifactRef, digest: str) -> str:
    if reference.sha256 and digest != reference.sha256:
        raise TamperedArtifactError(
            f"The content of '{reference.name}' has changed since it was referenced.",
            field="sha256",
            value=digest,
            accepted=reference.sha256,
        )
    return digest


def _written(facts: Mapping[str, Any]) -> float:
    """When a file was written, from what its file system tells of it: seconds, or a moment; 0 where neither."""
    told = facts.get("mtime", facts.get("LastModified", facts.get("created", 0.0)))
    return float(told.timestamp() if hasattr(told, "timestamp") else told)


def _prefix(owner: str, name: str) -> str:
    """How the temporary folder of a job begins where the store is not on this machine."""
    return f"smokeglint-{owner}-{name}-"


def describe_file(path: Path, **own: Any) -> FileEntry:
    """The manifest entry of a staged file; ``own`` may state simulated, simulated_share, oldest_input and source."""
    digest = Location(fsspec.filesystem("file"), str(path)).sha256()
    return FileEntry(sha256=digest, size=path.stat().st_size, type=media_type(path.name), **own)
