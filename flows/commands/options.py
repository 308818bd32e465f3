"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

from shared.errors import DomainError

Root = Annotated[
    str, typer.Option("--root", help="folder of all artifacts, or s3://bucket/prefix", envvar="SMOKEGLINT_ROOT")
]
CaseName = Annotated[str, typer.Option("--case", help="name of a case, or a folder with case.toml")]


def box_of(text: str) -> tuple[float, float, float, float]:
    """A box from ``west,south,east,north`` in degrees; DomainError if it is none."""
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError as error:
        raise DomainError(f"'{text}' is no box.", field="area", value=text, accepted="west,south,east,north") from error
    if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
        raise DomainError(
            f"'{text}' is no box.", field="area", value=text, accepted="west < east, south < north, degrees"
        )
    return west, south, east, north
