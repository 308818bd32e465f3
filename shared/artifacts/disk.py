"""Files of this machine: written out for good, and dated so that the newest is the last made."""

from __future__ import annotations

import os
from pathlib import Path

from shared.artifacts.manifest import MANIFEST


def to_disk(path: Path) -> None:
    """Have the system write out a file or a folder's entries, and let others read the file."""
    if path.is_file():
        path.chmod(0o644)
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def later_than_siblings(manifest: Path, step: Path) -> None:
    """Date a manifest after those of the same step, even if the clock was put back: the newest is the last made."""
    latest = max((path.stat().st_mtime_ns for path in step.glob(f"*/{MANIFEST}")), default=0)
    if latest >= manifest.stat().st_mtime_ns:
        os.utime(manifest, ns=(latest + 1_000_000, latest + 1_000_000))
