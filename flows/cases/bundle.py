"""A case bundle: a folder with ``case.toml`` and the inputs of one region and period."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from shared.errors import ContractError, MissingArtifactError

CASE_FILE = "case.toml"
REQUIRED_INPUTS = (
    "receivers",
    "transmitters",
    "stations",
    "incidents",
    "detections",
    "weather_analysis",
    "weather_forecast",
    "fuels",
    "spacecraft",
    "smap",
)
REQUIRED_NATURE = ("surface",)


@dataclass(frozen=True)
class Provenance:
    """Where an input comes from: simulated or not, its source in words, the UTC time of its oldest datum."""

    simulated: bool
    source: str
    oldest: datetime


@dataclass(frozen=True)
class Case:
    """A case as its ``case.toml`` tells it.

    ``region`` is lon_min, lat_min, lon_max, lat_max in degrees. ``inputs`` may enter the loop (each under its
    known-at rule); ``nature`` is for ``simulate-observations`` and for scoring, and for nothing else. ``bundles`` are
    the folders of the cycles' own inputs, where each has its own (a live case); empty: one bundle serves all.
    """

    folder: Path
    name: str
    title: str
    simulated: bool
    region: tuple[float, float, float, float]
    first_cutoff: datetime
    cycles: int
    cycle_hours: int
    inputs: Mapping[str, Path]
    nature: Mapping[str, Path]
    provenance: Mapping[str, Provenance]
    bundles: tuple[Path, ...] = ()

    def path(self, logical: str) -> Path:
        """The file or folder behind a logical name of ``inputs`` or ``nature``; MissingArtifactError if unknown."""
        known = {**self.inputs, **self.nature}
        if logical not in known:
            raise MissingArtifactError(
                f"Case '{self.name}' has no '{logical}'.", field=logical, accepted=", ".join(sorted(known))
            )
        return known[logical]

    def has(self, logical: str) -> bool:
        """Whether the case carries this optional input."""
        return logical in self.inputs or logical in self.nature

    def cutoff(self, cycle: int, cycle_hours: int | None = None) -> datetime:
        """The cut-off of cycle 1, 2, ... : only what had been delivered by then may enter it."""
        return self.first_cutoff + (cycle - 1) * timedelta(hours=cycle_hours or self.cycle_hours)


def read_case(folder: str | Path) -> Case:
    """Read and check a case; ContractError names the entry at fault, MissingArtifactError a file that is not there."""
    root = Path(folder)
    try:
        document = tomllib.loads((root / CASE_FILE).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise MissingArtifactError(
            f"There is no {CASE_FILE} in '{root.name}'.", field="case", accepted=f"a folder with a {CASE_FILE}"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ContractError(f"{CASE_FILE} is not TOML: {error}", field=CASE_FILE) from error
    head = _section(document, "case")
    inputs = _files(root, document, "inputs", REQUIRED_INPUTS)
    nature = _files(root, document, "nature", REQUIRED_NATURE)
    return Case(
        folder=root,
        name=_entry(head, "name", str),
        title=_entry(head, "title", str),
        simulated=_entry(head, "simulated", bool),
        region=_region(head),
        first_cutoff=_time(_entry(head, "first_cutoff", (str, datetime)), "case.first_cutoff"),
        cycles=_count(head, "cycles"),
        cycle_hours=_count(head, "cycle_hours"),
        inputs=inputs,
        nature=nature,
        provenance=_provenance(document, [*inputs, *nature]),
    )


def write_case(
    folder: str | Path,
    *,
    name: str,
    title: str,
    simulated: bool,
    region: tuple[float, float, float, float],
    first_cutoff: datetime,
    cycles: int,
    cycle_hours: int,
    inputs: Mapping[str, str],
    nature: Mapping[str, str],
    provenance: Mapping[str, Provenance],
) -> Case:
    """Write ``case.toml`` over files already in the folder (paths relative to it) and read it back, checked."""
    lines = [
        "[case]",
        f"name = {_quoted(name)}",
        f"title = {_quoted(title)}",
        f"simulated = {_quoted(simulated)}",
        f"region = [{', '.join(f'{edge:.6g}' for edge in map(float, region))}]",
        f"first_cutoff = {_quoted(iso(first_cutoff))}",
        f"cycles = {cycles}",
        f"cycle_hours = {cycle_hours}",
    ]
    for section, files, why in (
        ("inputs", inputs, ""),
        ("nature", nature, "# Only for simulate-observations and for scoring: no other step may see these."),
    ):
        lines += ["", *([why] if why else []), f"[{section}]"]
        lines += [f"{logical} = {_quoted(path)}" for logical, path in sorted(files.items())]
    for logical, origin in sorted(provenance.items()):
        lines += ["", f"[provenance.{logical}]", f"simulated = {_quoted(origin.simulated)}"]
        lines += [f"source = {_quoted(origin.source)}", f"oldest = {_quoted(iso(origin.oldest))}"]
    (Path(folder) / CASE_FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_case(folder)


def iso(time: datetime) -> str:
    """A UTC time as text, to the second."""
    return time.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _quoted(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)  # JSON texts and booleans are TOML ones


def _section(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = document.get(name)
    if not isinstance(section, dict):
        raise ContractError(f"{CASE_FILE} lacks the table [{name}].", field=name, accepted="case, inputs, nature")
    return section


def _entry(section: Mapping[str, Any], name: str, kind: Any) -> Any:
    value = section.get(name)
    if not isinstance(value, kind):
        words = " or ".join(k.__name__ for k in kind) if isinstance(kind, tuple) else kind.__name__
        raise ContractError(
            f"{CASE_FILE}: case.{name} is {value!r}; accepted: {words}.",
            field=f"case.{name}",
            value=value,
            accepted=words,
        )
    return value


def _count(section: Mapping[str, Any], name: str) -> int:
    value = _entry(section, name, int)
    if isinstance(value, bool) or value < 1:
        raise ContractError(
            f"{CASE_FILE}: case.{name} is {value!r}; accepted: a whole number from 1.",
            field=f"case.{name}",
            value=value,
            accepted="a whole number from 1",
        )
    return int(value)


def _region(section: Mapping[str, Any]) -> tuple[float, float, float, float]:
    value = _entry(section, "region", list)
    numbers = [float(v) for v in value if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(numbers) == 4 == len(value):
        west, south, east, north = numbers
        if -180 <= west < east <= 180 and -90 <= south < north <= 90:
            return west, south, east, north
    accepted = "[lon_min, lat_min, lon_max, lat_max] in degrees, minima below maxima"
    raise ContractError(
        f"{CASE_FILE}: case.region is {value!r}; accepted: {accepted}.",
        field="case.region",
        value=value,
        accepted=accepted,
    )


def _time(value: str | datetime, field: str) -> datetime:
    try:
        time = value if isinstance(value, datetime) else datetime.fromisoformat(value)
        if time.tzinfo is None:
            raise ValueError("no time zone")
    except ValueError as error:
        raise ContractError(
            f"{CASE_FILE}: {field} is {value!r} ({error}); accepted: an ISO 8601 time in UTC.",
            field=field,
            value=value,
            accepted="e.g. 2025-09-01T00:00:00Z",
        ) from error
    return time.astimezone(UTC)


def _files(root: Path, document: Mapping[str, Any], section: str, required: tuple[str, ...]) -> dict[str, Path]:
    entries = _section(document, section)
    missing = [name for name in required if name not in entries]
    if missing:
        raise ContractError(
            f"{CASE_FILE}: [{section}] lacks {', '.join(missing)}.", field=missing[0], accepted=", ".join(required)
        )
    files = {}
    for logical, relative in entries.items():
        path = root / str(relative)
        if not path.resolve().is_relative_to(root.resolve()):
            raise ContractError(
                f"{CASE_FILE}: {section}.{logical} leads out of the case folder.",
                field=f"{section}.{logical}",
                value=relative,
                accepted="a path inside the case folder",
            )
        if not path.exists():
            raise MissingArtifactError(
                f"{CASE_FILE}: {section}.{logical} names '{relative}', which is not there.",
                field=f"{section}.{logical}",
                value=relative,
                accepted="an existing file",
            )
        files[logical] = path
    return files


def _provenance(document: Mapping[str, Any], logicals: list[str]) -> dict[str, Provenance]:
    section = document.get("provenance", {})
    found = {}
    for logical in logicals:
        entry = section.get(logical)
        if not isinstance(entry, dict) or not {"simulated", "source", "oldest"} <= set(entry):
            raise ContractError(
                f"{CASE_FILE} lacks [provenance.{logical}] with simulated, source and oldest.",
                field=f"provenance.{logical}",
                accepted="simulated (boolean), source (text), oldest (UTC time)",
            )
        oldest = _time(entry["oldest"], f"provenance.{logical}.oldest")
        found[logical] = Provenance(bool(entry["simulated"]), str(entry["source"]), oldest)
    return found
