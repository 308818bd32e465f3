"""What the ingest has kept of a source, how old it is, and what is to be said of its age."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from flows.ingest.taking import Taken, kept_files

HOUR = timedelta(hours=1)


@dataclass(frozen=True)
class Limits:
    """``stale``: older data are used and called stale; ``useless``: they are not used any more."""

    stale: timedelta
    useless: timedelta


# Stale as the ingest has it. Useless: elements as the access service leaves them out; a fire not reported in three days
# says nothing; a forecast serves while it has hours ahead, which is 48 h of HRRR at most.
LIMITS = {
    "receivers": Limits(timedelta(days=7), timedelta(days=30)),
    "transmitters": Limits(timedelta(days=7), timedelta(days=30)),
    "incidents": Limits(timedelta(hours=24), timedelta(days=3)),
    "detections-firms": Limits(timedelta(hours=12), timedelta(days=3)),
    "detections-hms": Limits(timedelta(hours=36), timedelta(days=3)),
    "hrrr": Limits(timedelta(hours=18), timedelta(hours=48)),
}


# Lists whose rows say themselves from when they are: what is of after the cut-off is left out row by row.
BY_ROW = ("incidents", "detections")


def newest(source: str, folder: Path, cutoff: datetime) -> Taken | None:
    """The newest kept file of a source whose data are of no later than the cut-off; None where its age is useless.

    Of a list the newest whatever: fetched some minutes after the cut-off it holds what was known before.
    """
    for taken in kept_files(source, folder):
        if taken.data_time <= cutoff or source.startswith(BY_ROW):
            return taken if taken.age(cutoff) <= _limits(source).useless else None
    return None


def pages(source: str, folder: Path, cutoff: datetime) -> list[Taken]:
    """The newest kept file of a source and those of its further pages (``source-001000`` and on)."""
    names = sorted(path.name for path in folder.glob(f"{source}-[0-9]*") if path.is_dir())
    found = [newest(name, folder, cutoff) for name in (source, *names)]
    return [taken for taken in found if taken is not None]


def _limits(source: str) -> Limits:
    return LIMITS.get(source) or LIMITS[source.split("-")[0]]


def said(source: str, taken: Sequence[Taken], cutoff: datetime) -> str:
    """Provider, time and age in words, for case.toml and for people."""
    limit = _limits(source).stale
    oldest = min(taken, key=lambda one: one.data_time)
    age = oldest.age(cutoff)
    providers = ", ".join(sorted({one.provider for one in taken}))
    stale = f"; STALE, older than {limit / HOUR:g} h" if age > limit else ""
    return f"{providers}, data of {oldest.data_time:%Y-%m-%d %H:%M} UTC, {max(age / HOUR, 0):.1f} h old{stale}"
