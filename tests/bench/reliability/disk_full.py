"""A disk that fills in the middle of a cycle: ``python -m tests.bench.reliability.disk_full``, as root, on Linux.

The artifact root, with the job registers and Prefect's database, lies on a file system of its own in memory (tmpfs),
which holds a share of what the tiny case needs. The turn that meets its end must fail and leave nothing half-written;
once the file system is larger, the next turn must end with the artifacts of an undisturbed run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.bench.reliability import traces
from tests.bench.reliability.chaos import Reference, remembered, start_flow
from tests.bench.reliability.supervision import Platform

LIMIT_S, ROOMY_MB = 1500.0, 2000


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Fill the disk in the middle of a cycle.")
    parser.add_argument("--shares", type=float, nargs="*", default=[0.4, 0.8], help="of the room that a run needs")
    parser.add_argument("--folder", type=Path, default=None, help="where the undisturbed run is kept")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="smokeglint-disk-") as scratch:
        folder = (given.folder or Path(scratch)).resolve()
        reference, met = remembered(folder), True
        needed_mb = sum(path.stat().st_size for path in (folder / "reference").rglob("*") if path.is_file()) / 1e6
        for share in given.shares:
            told = trial(Path(scratch) / "disk", round(share * needed_mb), reference)
            print(json.dumps({"needed_mb": round(needed_mb), **told}), flush=True)
            met &= bool(told["ok"])
    return 0 if met else 1


def trial(disk: Path, room_mb: int, reference: Reference) -> dict[str, Any]:
    """One turn on the small disk, one after it has grown."""
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={room_mb}m", "tmpfs", str(disk)], check=True)
    root = disk / "artifacts"
    platform = Platform(root, disk.with_suffix(".logs"))
    try:
        platform.wait_until_ready()
        first = _turn(platform)
        found = traces.artifacts(root)
        finished, half = len(traces.steps_in_order(root)), traces.half_written(root)
        wrong = [path for path in found if "catalogue" not in path and reference.artifacts.get(path) != found[path]]
        subprocess.run(["mount", "-o", f"remount,size={ROOMY_MB}m", str(disk)], check=True)
        time.sleep(2.0)  # slots wait for their register in halves of a second
        second = _turn(platform)
        same = traces.artifacts(root) == reference.artifacts
        left = {"staged": len(traces.staged(root)), "open_jobs": len(traces.open_jobs(platform.urls))}
    finally:
        platform.stop()
        subprocess.run(["umount", str(disk)], check=True)
        disk.rmdir()
    told = {"room_mb": room_mb, "first_turn": first, "steps_finished": finished, "half_written": half, "wrong": wrong}
    ok = first != 0 and not half and not wrong and second == 0 and same and not any(left.values())
    return {"ok": ok, **told, "second_turn": second, "same_artifacts": same, **left}


def _turn(platform: Platform) -> int:
    flow = start_flow(platform)
    try:
        return flow.wait(LIMIT_S)
    except subprocess.TimeoutExpired:
        flow.kill()
        return flow.wait()


if __name__ == "__main__":
    sys.exit(main())
