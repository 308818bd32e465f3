"""API keys from the shell: add, list, rotate, remove. A key is shown once, when it is made."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from shared.errors import DomainError
from shared.security.api_keys import add_key, read_keys, remove_keys
from shared.security.principal import SCOPES

app = typer.Typer(help="API keys of the services.", no_args_is_help=True)
KeyFile = Annotated[Path, typer.Option("--file", help="the key file", envvar="SMOKEGLINT_SERVICE_API_KEYS")]


@app.command()
def add(
    name: str,
    file: KeyFile,
    scope: Annotated[list[str], typer.Option(help=f"{', '.join(SCOPES)}; each holds those before it")] = ["read"],  # noqa: B006
    days: Annotated[int, typer.Option(help="how long it is valid; 0: for ever")] = 0,
    save_to: Annotated[Path | None, typer.Option(help="write the key into this file instead of showing it")] = None,
) -> None:
    """Make a key. Services that use the file know it at once."""
    unknown = [item for item in scope if item not in SCOPES]
    if unknown:
        raise DomainError(f"There is no scope '{unknown[0]}'.", field="scope", accepted=", ".join(SCOPES))
    expires = datetime.now(UTC) + timedelta(days=days) if days else None
    key = add_key(file, name, tuple(item for item in SCOPES if item in scope), expires)
    if save_to is None:
        print(key)
    else:
        save_to.touch(mode=0o600)
        save_to.write_text(key + "\n", encoding="utf-8")


@app.command()
def prepare(
    folder: Path,
    stores: Annotated[Path | None, typer.Option(help="folder for passwords of PostgreSQL and of the S3 store")] = None,
) -> None:
    """Make, once, a folder of keys: ``keys.json``, ``flow.key`` of the loop and ``admin.key`` of the administrator."""
    if stores is not None:
        _prepare_stores(stores)
    folder.mkdir(parents=True, exist_ok=True)
    for name, scope in (("flow", "execute"), ("admin", "admin")):
        if not (folder / f"{name}.key").exists():
            add(name, folder / "keys.json", [scope], save_to=folder / f"{name}.key")


def _prepare_stores(folder: Path) -> None:
    """Passwords of the two stores, once, in the forms that servers and clients read them in."""
    if (folder / "pgpass").exists():  # written last
        return
    folder.mkdir(parents=True, exist_ok=True)
    password, identity, secret = secrets.token_urlsafe(32), secrets.token_hex(10), secrets.token_urlsafe(32)
    credentials = f"[default]\naws_access_key_id = {identity}\naws_secret_access_key = {secret}\n"
    # The servers read theirs under user names of their own; the folder is shared by the containers only.
    for name, mode, text in (
        ("postgres.password", 0o644, password),
        ("s3.id", 0o644, identity),
        ("s3.secret", 0o644, secret),
        ("aws", 0o600, credentials),
        ("pgpass", 0o600, f"*:*:*:smokeglint:{password}\n"),
    ):
        path = folder / name
        path.unlink(missing_ok=True)
        path.touch(mode=mode)
        path.write_text(text, encoding="utf-8")
        path.chmod(mode)


@app.command("list")
def list_keys(file: KeyFile) -> None:
    """Who has a key, for what, until when."""
    table = Table("name", "scopes", "expires", "begins with (of its hash)")
    for entry in read_keys(file):
        expires = entry.expires.isoformat(timespec="minutes") if entry.expires else "never"
        table.add_row(entry.name, ", ".join(entry.scopes), expires, entry.sha256[:8])
    Console().print(table)


@app.command()
def remove(
    name: str,
    file: KeyFile,
    old_only: Annotated[bool, typer.Option("--old-only", help="keep the newest: the end of a rotation")] = False,
) -> None:
    """Remove the keys of that name."""
    gone = remove_keys(file, name, keep_newest=old_only)
    if not gone and not old_only:
        raise DomainError(f"There is no key named '{name}' in {file}.", field="name", value=name)
    print(f"removed {gone}")
