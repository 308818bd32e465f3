"""Mean orbital elements of SGP4: one satellite's set, its age, and what makes a list of them unusable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal, Protocol, TypeVar

import numpy as np
from sgp4.api import Satrec

from shared.errors import DomainError

DAY_NOT_SAID = datetime.min.replace(tzinfo=UTC)  # of a decay whose day is not known


class Placed(Protocol):
    """Anything with a name and a place in a file."""

    @property
    def name(self) -> str: ...

    @property
    def where(self) -> str: ...


@dataclass(frozen=True)
class ElementSet:
    """One satellite's elements: its name here, catalogue number, epoch (UTC), SGP4 record and place in the file.

    ``decayed``: when it came down, where the catalogue says so (``DAY_NOT_SAID`` where it says only that it did).
    """

    name: str
    catalogue_number: int
    epoch: datetime
    record: Satrec
    where: str
    source: Literal["tle", "omm"] = "tle"
    decayed: datetime | None = None

    def age_days(self, when: datetime) -> float:
        """Days from the epoch to ``when``; negative where the epoch lies after it."""
        return (when - self.epoch) / timedelta(days=1)


Something = TypeVar("Something", bound=Placed)


def within_age(
    elements: Iterable[ElementSet], start: datetime, max_age_days: float, field: str, *, others: bool = False
) -> tuple[list[ElementSet], dict[str, str]]:
    """The element sets whose epoch lies within ``max_age_days`` of ``start``, and the others: name -> reason.

    Raises DomainError naming the nearest epoch and its line where none is near enough, unless there are ``others`` to
    use.
    """
    every = list(elements)
    near = [element for element in every if abs(element.age_days(start)) <= max_age_days]
    if every and not near and not others:
        best = min(every, key=lambda element: abs(element.age_days(start)))
        raise DomainError(
            f"{field}: every epoch is far from the start {start:%Y-%m-%dT%H:%M:%SZ}; the nearest, of {best.name} in "
            f"{best.where}, is {best.epoch:%Y-%m-%dT%H:%M:%SZ}, {_distance(best, start)}.",
            field=field,
            value=best.epoch.isoformat(),
            accepted=f"an epoch within {max_age_days:g} days of the start",
        )
    dropped = {
        element.name: f"the epoch in {element.where} lies {abs(element.age_days(start)):.1f} days "
        f"{'before' if element.age_days(start) > 0 else 'after'} the start"
        for element in every
        if element not in near
    }
    return near, dropped


def _distance(element: ElementSet, start: datetime) -> str:
    age = element.age_days(start)
    return f"{abs(age):.1f} days away ({'before' if age > 0 else 'after'} it)"


def refuse_impossible(record: Satrec, where: str, field: str) -> None:
    """DomainError where the elements make no orbit about the Earth."""
    checks = (
        ("eccentricity", record.ecco, 0.0, 1.0, "0 to below 1"),
        ("inclination", float(np.degrees(record.inclo)), 0.0, 180.0 + 1e-9, "0 to 180 degrees"),
        ("mean motion", record.no_kozai * 720.0 / np.pi, 1e-6, 20.0, "above 0 to 20 revolutions a day"),
    )
    for name, value, low, high, accepted in checks:
        if not low <= value < high:
            raise DomainError(
                f"{field}: {where}: {name} {value:g} makes no orbit.",
                field=field,
                value=float(value),
                accepted=accepted,
            )


def refuse_duplicates(
    rows: Sequence[Something], field: str, what: str, key: Callable[[Something], str | int | None]
) -> None:
    """DomainError naming both places where two rows share a key; keys that are None do not count."""
    seen: dict[str | int, Something] = {}
    for row in rows:
        value = key(row)
        if value is None:
            continue
        first = seen.setdefault(value, row)
        if first is not row:
            raise DomainError(
                f"{field}: {what} {value} is given twice, in {first.where} and {row.where}.",
                field=field,
                value=value,
                accepted="one orbit per satellite",
            )
