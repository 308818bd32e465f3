"""The live case under a root: a folder with its frame and a bundle for each cycle; a bundle is never made twice."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

from flows.cases.bundle import CASE_FILE, Case, iso, read_case
from flows.cases.live.build import NAME, Box, build_live, utc_minute
from flows.loop_types import cycle_label
from shared.errors import MissingArtifactError

FRAME_FILE = "live.json"
CYCLE_HOURS = 24


@dataclass(frozen=True)
class Frame:
    """What stays the same from bundle to bundle: the box, the folder of fetched files, the first cut-off (UTC)."""

    area: Box
    ingested: Path
    first_cutoff: datetime

    def cutoff_of(self, now: datetime) -> datetime:
        """The last cut-off by ``now``."""
        passed = max(0, (now - self.first_cutoff) // timedelta(hours=CYCLE_HOURS))
        return self.first_cutoff + passed * timedelta(hours=CYCLE_HOURS)


def live_folder(root: Path) -> Path:
    """Where the live case of a root lies."""
    return root / ".cases" / NAME


def read_frame(root: Path) -> Frame:
    """The frame of the live case; MissingArtifactError says how to begin one."""
    path = live_folder(root) / FRAME_FILE
    if not path.is_file():
        raise MissingArtifactError(
            "There is no live case here yet: 'smokeglint ingest --area W,S,E,N', then "
            "'smokeglint case build live --area W,S,E,N'.",
            field="case",
            value=NAME,
            accepted="a live case that has been built once",
        )
    told = json.loads(path.read_text(encoding="utf-8"))
    west, south, east, north = told["area"]
    return Frame((west, south, east, north), Path(told["ingested"]), datetime.fromisoformat(told["first_cutoff"]))


def begin(root: Path, area: Box, ingested: Path, now: datetime) -> Frame:
    """The frame of a new live case, or that of the present one where the box is the same; another box starts afresh,
    and the case of the former one is put aside.

    Its first cut-off is the minute that has begun.
    """
    folder = live_folder(root)
    if (folder / FRAME_FILE).is_file() and read_frame(root).area == area:
        frame = replace(read_frame(root), ingested=ingested.resolve())
    else:
        if folder.exists():  # what was planned on it can still be looked up
            folder.rename(folder.with_name(f"{NAME}-until-{utc_minute(now):%Y%m%dT%H%M%SZ}"))
        frame = Frame(area, ingested.resolve(), utc_minute(now))
    folder.mkdir(parents=True, exist_ok=True)
    told = {"area": list(frame.area), "ingested": str(frame.ingested), "first_cutoff": iso(frame.first_cutoff)}
    fresh = folder / f".{FRAME_FILE}"
    fresh.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    fresh.replace(folder / FRAME_FILE)
    return frame


def has_bundle(root: Path, now: datetime) -> bool:
    """Whether the cycle that has begun by ``now`` has its bundle."""
    return (live_folder(root) / cycle_label(read_frame(root).cutoff_of(now)) / CASE_FILE).is_file()


def add_bundle(root: Path, now: datetime) -> Case:
    """The bundle of the cycle that has begun by ``now``: made from what is kept, unless it has been made before."""
    frame = read_frame(root)
    cutoff = frame.cutoff_of(now)
    folder = live_folder(root) / cycle_label(cutoff)
    if not (folder / CASE_FILE).is_file():
        fresh = folder.with_name(f".{folder.name}")
        shutil.rmtree(fresh, ignore_errors=True)
        shutil.rmtree(folder, ignore_errors=True)
        build_live(frame.ingested, fresh, frame.area, cutoff)
        fresh.rename(folder)
    return read_case(folder)


def read_live(root: Path) -> Case:
    """The live case: the head of its newest bundle, from the first cut-off on, with the bundle of every cycle.

    A cycle of which no bundle was made goes on with the one before it, so with older data.
    """
    read_frame(root)  # without one it says how to begin
    made = sorted(path.parent for path in live_folder(root).glob(f"2*/{CASE_FILE}"))
    if not made:
        raise MissingArtifactError("The live case has no bundle yet: 'smokeglint case build live'.", field="case")
    newest, first = read_case(made[-1]), read_case(made[0]).first_cutoff  # later than the frame's if that build failed
    cycles = (newest.first_cutoff - first) // timedelta(hours=CYCLE_HOURS) + 1
    cutoffs = [first + number * timedelta(hours=CYCLE_HOURS) for number in range(cycles)]
    bundles = tuple(max(path for path in made if path.name <= cycle_label(cutoff)) for cutoff in cutoffs)
    return replace(newest, first_cutoff=first, cycles=cycles, bundles=bundles)
