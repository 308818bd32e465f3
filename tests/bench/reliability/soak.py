"""A day of hourly cycles without a pause: ``python -m tests.bench.reliability.soak``, one JSON object a line.

The tiny case in cycles of one hour instead of a day, 24 of them one after the other, through one set of services and
workers and one process of the flow; the case's own time is the clock. After each cycle the resident memory of every
process is taken. The slopes are fitted over the second half: imports, compiled code and first buffers come before.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from flows.services import SERVICES
from tests.bench.reliability import traces
from tests.bench.reliability.supervision import Platform

LAST_STEP = "score"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Run hourly cycles and watch the memory.")
    parser.add_argument("--cycles", type=int, default=24)
    parser.add_argument(
        "--folder", type=Path, default=None, help="where the run is kept; a temporary folder by default"
    )
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="smokeglint-soak-") as scratch:
        root = (given.folder or Path(scratch)).resolve() / "artifacts"
        platform = Platform(root, root.with_suffix(".logs"))
        os.environ.update(platform.environment)
        try:
            platform.wait_until_ready()
            taken = hourly_cycles(platform, given.cycles)
            print(json.dumps(summary(platform, taken)), flush=True)
        finally:
            platform.stop()
    return 0


def hourly_cycles(platform: Platform, cycles: int) -> list[dict[str, float]]:
    """Run them; the resident memory (MB) of each process after each cycle."""
    from flows.case_run import run_case
    from flows.cycle import PrefectConductor  # prefect reads its settings when it is imported
    from flows.demo import build_case
    from flows.desk.approval import PeopleDecide
    from flows.loop_types import FEEDBACKS
    from flows.profiles import profile_of
    from flows.runner import StepEvent, open_store

    case = build_case("tiny", platform.root)
    profile = profile_of("tiny")
    profile = replace(profile, settings=replace(profile.settings, cycle_hours=1, release_after_h=0.1))
    taken: list[dict[str, float]] = []
    last = time.monotonic()

    def watch(event: StepEvent) -> None:
        nonlocal last
        if event.done and event.process == LAST_STEP and re.fullmatch(r"\d{8}T\d{4}Z", event.cycle):
            taken.append(resident_mb(platform))
            now = time.monotonic()
            told = {"cycle": event.cycle, "seconds": round(now - last, 1), "resident_mb": taken[-1]}
            last = now
            print(json.dumps(told), flush=True)

    store = open_store(platform.root, case.folder)
    desk = PeopleDecide.of_case(platform.root, case.name, automatic=True)
    given = (case, store, platform.root, platform.urls, watch, profile, frozenset(FEEDBACKS), range(1, cycles + 1))
    run_case(PrefectConductor(), *given, again_plain=False, desk=desk)
    return taken


def resident_mb(platform: Platform) -> dict[str, float]:
    """Resident memory of the flow, Prefect's server, each service and its worker."""
    running = platform.supervisor
    pids = {"flow": os.getpid(), "prefect": running.pid("prefect")}
    for name in SERVICES:
        pids[name] = running.pid(name)
        pids[f"{name}-worker"] = running.worker_of(name) or running.pid(name)
    return {name: round(psutil.Process(pid).memory_info().rss / 1e6, 1) for name, pid in pids.items()}


def summary(platform: Platform, taken: list[dict[str, float]]) -> dict[str, Any]:
    """Growth by process in MB a cycle over the second half, and what was left behind."""
    half = taken[len(taken) // 2 :]
    slopes = {
        name: round(float(np.polyfit(range(len(half)), [row[name] for row in half], 1)[0]), 2) for name in half[0]
    }
    totals = [sum(row.values()) for row in taken]
    return {
        "cycles": len(taken),
        "mb_per_cycle": slopes,
        "total_mb": {"first": round(totals[0]), "half": round(totals[len(totals) // 2]), "last": round(totals[-1])},
        "restarts": sum(platform.supervisor.restarts.values()),
        "half_written": len(traces.half_written(platform.root)),
        "staged": len(traces.staged(platform.root)),
        "open_jobs": len(traces.open_jobs(platform.urls)),
    }


if __name__ == "__main__":
    sys.exit(main())
