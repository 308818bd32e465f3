"""``smokeglint backup`` and ``smokeglint restore``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows.backup import back_up, restore
from flows.commands.options import Root


def backup(to: Annotated[Path, typer.Option(help="archive to write, .tar.gz")], root: Root = Path("artifacts")) -> None:
    """Back up artifacts, catalogues, decisions and databases; services may go on meanwhile."""
    count = back_up(root.resolve(), to.resolve())
    print(f"{count} files, {to.stat().st_size:,} bytes in {to}")


def restore_root(
    archive: Annotated[Path, typer.Option("--from", help="archive that 'backup' wrote")],
    root: Annotated[Path, typer.Option(help="new artifact root")],
) -> None:
    """Restore a backup into a new artifact root, and verify every step of it."""
    found = restore(archive.resolve(), root.resolve())
    print(f"{found.files} files, {found.verified} steps verified, {len(found.damaged)} damaged")
    for name in found.damaged:
        print(f"damaged, will be made again: {name}")
