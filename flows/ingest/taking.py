"""From a source to a file that a cycle may use: providers in their order, else the newest kept file, said aloud."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx

from flows.ingest.fetching import Limits, ProviderError, Request, fetch_checked
from shared.errors import SmokeglintError
from shared.telemetry import logger

_RECORD = ".record.json"  # beside each kept file: its hash, its time, and where it came from


@dataclass(frozen=True)
class Checked:
    """Content that has passed its check: as it is to be kept, and the UTC time that its newest data are of."""

    content: bytes
    data_time: datetime


@dataclass(frozen=True)
class Offer:
    """One way to get a source: a request, and the check that its answer must pass (ProviderError otherwise)."""

    request: Request
    check: Callable[[bytes], Checked]


@dataclass(frozen=True)
class Source:
    """A live input: its offers in order of preference, and the age beyond which a cycle must not use its data."""

    name: str
    suffix: str
    offers: Sequence[Offer]
    stale_after: timedelta
    limits: Limits = field(default_factory=Limits)


@dataclass(frozen=True)
class Taken:
    """What a cycle is given of a source. ``problems`` are in the order in which offers failed; fresh: came just now."""

    source: str
    path: Path
    data_time: datetime
    provider: str
    fresh: bool
    problems: tuple[str, ...]

    def age(self, now: datetime) -> timedelta:
        return now - self.data_time


class StaleSourceError(SmokeglintError):
    """No offer gave data, and what is kept is too old or not there."""


def take(source: Source, folder: Path, now: datetime, client: httpx.Client) -> Taken:
    """The source's newest data: fetched if any offer gives some, else the newest kept within its limit of age.

    What was fetched is kept under ``folder/source`` with its hash, its time and where it came from.
    StaleSourceError names what every offer answered.
    """
    problems: list[str] = []
    kept = next(kept_files(source.name, folder), None)
    for offer in source.offers:
        try:
            checked = fetch_checked(client, offer.request, offer.check, source.limits)
        except ProviderError as error:
            problems.append(str(error))
            logger().warning("source failed", source=source.name, problem=str(error))
            continue
        if checked.data_time > now + timedelta(minutes=5) and source.suffix != ".grib2":
            problems.append(f"{offer.request.provider}: its data are of the future ({checked.data_time.isoformat()})")
            continue
        if kept is None or checked.data_time >= kept.data_time:
            kept = _keep(source, folder, checked, offer.request, tuple(problems))
        else:
            problems.append(f"{offer.request.provider}: its data are older than what is kept")
        break
    if kept is None or kept.age(now) > source.stale_after:
        age = f"what is kept is of {kept.data_time:%Y-%m-%d %H:%M} UTC" if kept else "nothing is kept"
        limit_h = source.stale_after / timedelta(hours=1)
        said = "; ".join(problems) or "every offer was older"
        raise StaleSourceError(f"{source.name}: {age}, data may be {limit_h:g} h old at most. {said}")
    return Taken(**{**vars(kept), "problems": tuple(problems)})


def kept_files(source: str, folder: Path) -> Iterator[Taken]:
    """The kept files of a source whose content is still what its record says, newest data first."""
    for record in sorted((folder / source).glob(f"*{_RECORD}"), reverse=True):
        told = json.loads(record.read_bytes())
        path = record.with_name(told["file"])
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == told["sha256"]:
            time = datetime.fromisoformat(told["data_time"])
            yield Taken(source, path, time, told["provider"], False, ())
        else:
            logger().error("a kept file is damaged and left out", source=source, file=told["file"])


def _keep(source: Source, folder: Path, checked: Checked, request: Request, problems: tuple[str, ...]) -> Taken:
    """Write the data, then their record; each appears whole or not at all."""
    digest = hashlib.sha256(checked.content).hexdigest()
    place = folder / source.name
    place.mkdir(parents=True, exist_ok=True)
    stem = f"{checked.data_time.astimezone(UTC):%Y%m%dT%H%M%SZ}-{digest[:12]}"
    path = place / f"{stem}{source.suffix}"
    _write(path, checked.content)
    told = {
        "file": path.name,
        "sha256": digest,
        "data_time": checked.data_time.isoformat(),
        "provider": request.provider,
        "url": request.name,
    }
    _write(path.with_name(stem + _RECORD), json.dumps(told, indent=1, sort_keys=True).encode())
    return Taken(source.name, path, checked.data_time, request.provider, True, problems)


def _write(path: Path, content: bytes) -> None:
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    with open(fresh, "wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    fresh.replace(path)
