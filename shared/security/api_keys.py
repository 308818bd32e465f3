"""API keys: random, kept as hashes in a file that may change while the service runs.

The file is JSON: ``{"keys": [{"name": "ops", "sha256": "…", "scopes": ["read", "execute"], "expires": null}]}``.
A key is 256 random bits, so a plain SHA-256 of it can neither be guessed nor be looked up.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import threading
from datetime import UTC, datetime
from pathlib import Path

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from shared.errors import DomainError
from shared.security.principal import Principal, Scope
from shared.telemetry import logger

PREFIX = "sg_"


class KeyEntry(BaseModel):
    """One key as it is stored; ``expires`` null: never."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str = Field(pattern=r"^[A-Za-z0-9._-]{1,64}$")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    scopes: tuple[Scope, ...] = Field(min_length=1)
    expires: AwareDatetime | None = None


class KeyFile(BaseModel):
    """The stored keys. Two entries may share a name: that is how a key is rotated."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    keys: tuple[KeyEntry, ...] = ()


class KeyRing:
    """Finds who holds a key. A changed file is read anew; a broken one is logged, and the last good one holds."""

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._lock = threading.Lock()
        self._keys = read_keys(self._path)
        self._seen = self._stamp()

    def holder(self, presented: str, now: datetime | None = None) -> Principal | None:
        """Who holds this key; None if nobody does or it has expired. A wrong key takes as long as a right one."""
        self._refresh()
        digest = hash_key(presented)
        found = [entry for entry in self._keys if hmac.compare_digest(entry.sha256, digest)]
        moment = now or datetime.now(UTC)
        valid = [entry for entry in found if entry.expires is None or entry.expires > moment]
        return Principal(valid[0].name, frozenset(valid[0].scopes)) if valid else None

    def _stamp(self) -> tuple[int, int, int]:
        status = self._path.stat()
        return status.st_mtime_ns, status.st_size, status.st_ino

    def _refresh(self) -> None:
        with self._lock:
            try:
                stamp = self._stamp()
                if stamp == self._seen:
                    return
                self._seen = stamp
                self._keys = read_keys(self._path)
            except (OSError, DomainError) as error:
                logger().error("the key file cannot be read; the keys read before hold", error=str(error))


def hash_key(key: str) -> str:
    """What is stored of a key."""
    return hashlib.sha256(key.encode()).hexdigest()


def read_keys(path: Path) -> tuple[KeyEntry, ...]:
    """The entries of a key file; DomainError if it is missing or none."""
    try:
        return KeyFile.model_validate_json(path.read_bytes()).keys
    except OSError as error:
        raise DomainError(f"The key file {path} cannot be read: {error.strerror}.", field="api_keys") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise DomainError(f"The key file {path} is wrong at '{where}': {first['msg']}.", field="api_keys") from error


def add_key(path: Path, name: str, scopes: tuple[Scope, ...], expires: datetime | None = None) -> str:
    """Store a new key and return it: the only time it is seen. The file is replaced at once and is its owner's only."""
    key = PREFIX + secrets.token_urlsafe(32)
    entry = KeyEntry(name=name, sha256=hash_key(key), scopes=scopes, expires=expires)
    _write(path, (*(read_keys(path) if path.exists() else ()), entry))
    return key


def remove_keys(path: Path, name: str, *, keep_newest: bool = False) -> int:
    """Remove the keys of that name, all or all but the newest; how many were removed."""
    before = read_keys(path)
    mine = [entry for entry in before if entry.name == name]
    gone = mine[:-1] if keep_newest else mine
    _write(path, tuple(entry for entry in before if entry not in gone))
    return len(gone)


def _write(path: Path, keys: tuple[KeyEntry, ...]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    document = {"keys": [entry.model_dump(mode="json") for entry in keys]}
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as stream:
        json.dump(document, stream, indent=1)
    fresh.replace(path)
