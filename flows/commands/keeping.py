"""``smokeglint backup`` and ``smokeglint restore``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows.backup import back_up, restore
from flows.commands.options import Root
from flows.root import named_root
from shared.artifacts.roots import is_local
from shared.errors import DomainError


def backup(to: Annotated[Path, typer.Option(help="archive to write, .tar.gz")], root: Root = "artifacts") -> None:
    """Back up artifacts, catalogues, decisions and databases; services may go on meanwhile."""
    count = back_up(root_on_disk(root), to.resolve())
    print(f"{count} files, {to.stat().st_size:,} bytes in {to}")


def root_on_disk(root: str) -> Path:
    """The folder of a root; DomainError for a store, which has means of its own."""
    if not is_local(named_root(root)):
        raise DomainError(
            f"{root} is no folder: keep copies of a bucket by versioning or replication (see docs/operations.md).",
            field="root",
            value=root,
            accepted="a folder",
        )
    return Path(named_root(root))


def restore_root(
    archive: Annotated[Path, typer.Option("--from", help="archive that 'backup' wrote")],
    root: Annotated[Path, typer.Option(help="new artifact root")],
) -> None:
    """Restore a backup into a new artifact root, and verify every step of it."""
    found = restore(archive.resolve(), root.resolve())
    print(f"{found.files} files, {found.verified} steps verified, {len(found.damaged)} damaged")
    for name in found.damaged:
        print(f"damaged, will be made again: {name}")
