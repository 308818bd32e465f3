"""The whole loop however its fan-outs are spread: ``python -m tests.bench.reliability.fan_outs``, a JSON object a line.

The tiny case runs from an empty root without a fan-out, over 1 and 4 processes, and over a Dask cluster of 1 and 4
workers; then again over 4 of each, one of which is killed while it works. The sha256 of every artifact and of the
catalogue must be that of the first run. ``at_work`` tells that the fan-out was really used: tasks that the cluster
finished, or processes of the pools that were seen.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from shared.fan_out import VARIABLE
from tests.bench.reliability import traces
from tests.bench.reliability.supervision import REPOSITORY

LIMIT_S, LOOK_S = 1500.0, 0.05
IMPORTED_S = 1.0  # processor time after which a process of a pool has its imports behind it


@dataclass
class FanOut:
    """One way to spread: ``kind`` is empty, ``processes`` or ``dask``; with ``kill`` one worker dies at work."""

    kind: str = ""
    workers: int = 0
    kill: bool = False
    killed: int = 0
    seen: set[int] = field(default_factory=set)
    cluster: Any = None

    @property
    def name(self) -> str:
        return f"{self.kind or 'here'}:{self.workers}"

    @contextlib.contextmanager
    def set_up(self) -> Iterator[str]:
        """The value of the setting, its cluster running."""
        if self.kind != "dask":
            yield f"{self.kind}:{self.workers}" if self.kind else ""
            return
        import distributed

        options: dict[str, Any] = {"dashboard_address": None, "processes": True, "silence_logs": 50}
        with distributed.LocalCluster(n_workers=self.workers, threads_per_worker=1, **options) as cluster:
            self.cluster = cluster
            yield f"dask:{cluster.scheduler_address}"

    def look(self, run: subprocess.Popen[bytes]) -> None:
        """Note who works for the run just now, and kill one of them if that is still to be done."""
        working = self._busy_dask() if self.kind == "dask" else _busy_pool(run.pid) if self.kind else []
        self.seen |= set(working)
        if self.kill and not self.killed and working:
            self.killed = working[0]
            os.kill(self.killed, signal.SIGKILL)

    def at_work(self) -> int:
        if self.cluster is None:
            return len(self.seen)
        return sum(prefix.state_counts["memory"] for prefix in self.cluster.scheduler.task_prefixes.values())

    def _busy_dask(self) -> list[int]:
        busy = {state.name for state in self.cluster.scheduler.workers.values() if state.processing}
        nannies = [(name, nanny.process) for name, nanny in self.cluster.workers.items() if name in busy]
        return [int(process.pid) for _, process in nannies if process and process.pid]


FAN_OUTS = (("", 0, False), ("processes", 1, False), ("processes", 4, False), ("dask", 1, False), ("dask", 4, False))
KILLS = (("processes", 4, True), ("dask", 4, True))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Run the tiny loop under each fan-out and hold the bytes together.")
    parser.add_argument("--services", action="store_true", help="through Prefect and five services, not in one process")
    parser.add_argument(
        "--only", type=int, nargs="*", help=f"which of the {len(FAN_OUTS + KILLS)} runs beside the first"
    )
    given = parser.parse_args(arguments)
    met, reference = True, dict[str, str]()
    for number, chosen in enumerate((*FAN_OUTS, *KILLS)):
        if number and given.only is not None and number not in given.only:
            continue
        with tempfile.TemporaryDirectory(prefix="smokeglint-fan-out-") as scratch:
            told, found = trial(FanOut(*chosen), Path(scratch) / "artifacts", given.services)
        reference = reference or found
        same = bool(found) and found == reference
        told |= {"files": len(found), "same": same, "ok": told["status"] == 0 and same}
        met &= told["ok"]
        print(json.dumps(told), flush=True)
    return 0 if met else 1


def trial(fan_out: FanOut, root: Path, services: bool) -> tuple[dict[str, Any], dict[str, str]]:
    """One whole run; what there is to tell of it, and the sha256 of all that it made."""
    command = [sys.executable, "-m", "flows.commands", "run", "--case", "tiny", "--root", str(root)]
    command += [] if services else ["--ephemeral"]
    with fan_out.set_up() as setting, root.with_suffix(".log").open("wb") as log:
        begun = time.monotonic()
        run = subprocess.Popen(command, cwd=REPOSITORY, env=os.environ | {VARIABLE: setting}, stdout=log, stderr=log)
        while run.poll() is None and time.monotonic() < begun + LIMIT_S:
            fan_out.look(run)
            time.sleep(LOOK_S)
        run.kill()
        status, wall_s = run.wait(), time.monotonic() - begun
        at_work = fan_out.at_work()
    if status:
        print(root.with_suffix(".log").read_text(errors="replace")[-3000:], file=sys.stderr)
    found = traces.artifacts(root)
    told = {"fan_out": fan_out.name, "killed": fan_out.kill and bool(fan_out.killed), "at_work": at_work}
    if fan_out.kill and not fan_out.killed:
        status = -1  # nobody was met at work: no trial of what it says
    digest = hashlib.sha256(json.dumps(sorted(found.items())).encode()).hexdigest()
    return told | {"status": status, "wall_s": round(wall_s, 1), "digest": digest[:16]}, found


def _busy_pool(pid: int) -> list[int]:
    """Processes of a pool below the run that have begun to work; the services' own workers are no pool."""
    with contextlib.suppress(psutil.Error):
        return [child.pid for child in psutil.Process(pid).children(recursive=True) if _at_work(child)]
    return []


def _at_work(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        spawned = "spawn_main" in " ".join(process.cmdline())
        times = process.cpu_times()
        return spawned and times.user + times.system > IMPORTED_S
    return False


if __name__ == "__main__":
    sys.exit(main())
