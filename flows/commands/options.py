"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Root = Annotated[Path, typer.Option("--root", help="folder of all artifacts", envvar="SMOKEGLINT_ROOT")]
CaseName = Annotated[str, typer.Option("--case", help="name of a case, or a folder with case.toml")]
