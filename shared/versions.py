"""The version of the code that made a product, from the sources themselves."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

RELEASE = "0.1.0"
_SOURCES = ("*.py", "*.ubj", "*.json", "*.parquet", "*.csv", "*.npz")


@functools.cache
def code_version(*packages: Path) -> str:
    """``release+digest`` over every source and shipped model of the given package folders.

    A digest, because a number that people must remember to raise is forgotten: a changed source never answers from an
    old manifest.
    """
    digest = hashlib.sha256()
    for package in packages:
        for path in sorted({path for pattern in _SOURCES for path in package.rglob(pattern)}):
            digest.update(str(path.relative_to(package.parent)).encode())
            digest.update(path.read_bytes())
    return f"{RELEASE}+{digest.hexdigest()[:12]}"
