"""One loop a root: a file lock where the root is a folder, a lease that is renewed where it lies on S3."""

from __future__ import annotations

import _thread
import fcntl
import json
import os
import posixpath
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from flows.root import ArtifactRoot, named_root
from shared.artifacts.roots import is_local, open_root
from shared.errors import DomainError, SmokeglintError
from shared.telemetry import logger

LOCK = ".lock"
_POLL_S = 0.5


def only_run(root: ArtifactRoot, wait_s: float = 0.0) -> AbstractContextManager[None]:
    """Hold the root's lock; DomainError if another still holds it after ``wait_s``.

    In a folder the system frees it even if this process is killed; the lease of a killed process runs out.
    """
    url = named_root(root)
    return _file_lock(Path(url), wait_s) if is_local(url) else Lease(url).held(wait_s)


@contextmanager
def _file_lock(root: Path, wait_s: float) -> Iterator[None]:
    root.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + wait_s
    with (root / LOCK).open("w") as lock:
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except OSError as error:
                if time.monotonic() >= deadline:
                    raise _taken(str(root)) from error
                time.sleep(_POLL_S)
        yield


class Lease:
    """The object ``.lock`` below a root on S3: made if there is none, replaced by those who have seen its last state.

    Both are conditional writes (``If-None-Match``, ``If-Match``), so of several at once one succeeds. The holder
    renews it every ``renew_s``; who has watched it unchanged for ``lease_s`` by his own clock takes it over, and the
    old holder, should it still live, finds that out at its next renewal and ends.
    """

    def __init__(self, url: str, lease_s: float = 30.0, renew_s: float = 8.0) -> None:
        self._url, self._lease_s, self._renew_s = url, lease_s, renew_s
        self._fs, root = open_root(url)
        self._bucket, _, key = posixpath.join(root, LOCK).partition("/")
        self._key = key
        self._holder = {"host": socket.gethostname(), "pid": os.getpid(), "id": uuid.uuid4().hex}
        self._tag = ""
        self._renewals = 0
        self._over = threading.Event()
        self._lost = False

    @contextmanager
    def held(self, wait_s: float) -> Iterator[None]:
        """Hold it; SmokeglintError if it was lost meanwhile."""
        self._take(wait_s)
        keeper = threading.Thread(target=self._keep, name="lease", daemon=True)
        keeper.start()
        try:
            yield
        except KeyboardInterrupt:
            if not self._lost:
                raise
        finally:
            self._over.set()
            keeper.join()
            if not self._lost:
                self._release()
        if self._lost:
            raise SmokeglintError(f"The lock of {self._url} could not be renewed; another run may have taken it over.")

    def _take(self, wait_s: float) -> None:
        begun = seen_since = time.monotonic()
        seen, renewed = "", False
        while not self._put(IfNoneMatch="*"):
            now, tag = time.monotonic(), self._current()
            if tag != seen:
                renewed, seen, seen_since = bool(seen), tag, now
            if tag and now - seen_since >= self._lease_s and self._put(IfMatch=tag):
                logger().warning("took over the lock of a run that is gone", root=self._url)
                return
            if renewed and now - begun >= wait_s:  # somebody renews it: that run is alive
                raise _taken(self._url)
            time.sleep(min(_POLL_S, self._renew_s))

    def _keep(self) -> None:
        last = time.monotonic()
        while not self._over.wait(self._renew_s):
            try:
                kept = self._put(IfMatch=self._tag) or self._is_ours()
            except Exception as error:  # a store that is away has errors of many kinds, and none may end the keeper
                logger().warning("the lock could not be renewed", root=self._url, error=repr(error))
                kept = time.monotonic() - last < self._lease_s
            else:
                last = time.monotonic()
            if not kept:
                self._lost = True
                if not self._over.is_set():  # else the work is done, and ``held`` tells of it
                    _thread.interrupt_main()
                return

    def _put(self, **condition: str) -> bool:
        """Write the lock under a condition; whether it held."""
        self._renewals += 1
        body = json.dumps(self._holder | {"renewals": self._renewals}, sort_keys=True).encode()
        try:
            made: dict[str, Any] = self._fs.call_s3(
                "put_object", Bucket=self._bucket, Key=self._key, Body=body, **condition
            )
        except OSError as error:
            if _http_status(error) in (404, 409, 412):  # not there any more; somebody writes just now; another state
                return False
            raise
        self._tag = str(made["ETag"])
        return True

    def _current(self) -> str:
        try:
            return str(self._fs.info(f"{self._bucket}/{self._key}")["ETag"])
        except FileNotFoundError:
            return ""

    def _is_ours(self) -> bool:
        """Whether the lock still names us: a write whose answer was lost is repeated, and then refused."""
        tag, path = self._current(), f"{self._bucket}/{self._key}"
        if not tag or json.loads(self._fs.cat_file(path))["id"] != self._holder["id"]:
            return False
        self._tag = tag
        return True

    def _release(self) -> None:
        """Remove it if it is still ours. A store that knows no conditional delete removes it all the same."""
        if self._current() == self._tag:
            self._fs.call_s3("delete_object", Bucket=self._bucket, Key=self._key)


def _http_status(error: BaseException) -> int:
    """The status of the answer behind an error of the S3 file system; 0 if there was none."""
    response = getattr(error.__cause__, "response", None) or {}
    return int(response.get("ResponseMetadata", {}).get("HTTPStatusCode", 0))


def _taken(root: str) -> DomainError:
    return DomainError(f"Another run works on {root}; wait for it or take another --root.")
