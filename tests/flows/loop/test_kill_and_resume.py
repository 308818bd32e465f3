"""A run killed with SIGKILL resumes at the step it was in, ends with the same bytes, and nothing of it remains."""

from __future__ import annotations

import hashlib
import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import TinyLoop

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]

REPOSITORY = Path(__file__).resolve().parents[3]
# The step after whose end the run is killed, late in the second cycle; tests.bench.reliability.chaos kills everywhere.
KILLED_IN = ("20250902T1200Z  retrieve-burned-area",)
LIMIT_S = 240


def start(root: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "flows.demo", "--case", "tiny", "--plain", "--root", str(root)]
    return subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def kill_when_shown(run: subprocess.Popen[str], word: str) -> list[str]:
    """Read the run's display until the step before ``word`` is shown, then kill it in the middle of the next one."""
    assert run.stdout is not None
    shown = []
    for line in run.stdout:
        shown.append(line)
        if word in line:
            break
    else:
        raise AssertionError("the run never came to " + word + "\n" + "".join(shown))
    time.sleep(0.15)
    run.send_signal(signal.SIGKILL)
    run.wait()
    return shown


def children_of(root: Path) -> list[int]:
    """Processes that work on an artifact root, told by their environment or command line."""
    mark, found = str(root).encode(), []
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        try:
            if mark in (process / "environ").read_bytes() or mark in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except OSError:
            continue
    return found


def artifacts(root: Path) -> dict[str, str]:
    """Hash of every artifact of the case, by its path below the root; the catalogue is made from them."""
    files = [path for path in (root / "simulated-tiny").rglob("*") if path.is_file()]
    wanted = [path for path in files if "catalogue" not in path.parts]
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in wanted}


def test_killed_runs_resume_and_end_with_the_same_bytes(tiny: TinyLoop, tmp_path: Path) -> None:
    root = tmp_path / "artifacts"
    for word in KILLED_IN:
        kill_when_shown(start(root), word)
    finished = {path: path.stat().st_mtime_ns for path in (root / "simulated-tiny").rglob("manifest.json")}
    assert len(finished) > 20
    done = start(root)
    output, _ = done.communicate(timeout=LIMIT_S)
    assert done.returncode == 0, output
    assert {path: path.stat().st_mtime_ns for path in finished} == finished, "a finished step was done again"
    assert "Closed 1 flow run(s)" in output, output

    expected = artifacts(tiny.root)
    ours = artifacts(root)
    parts = {"bundle", "calibration", *(cycle.label for cycle in tiny.cycles)}
    shared = {path for path in expected if path.split("/")[1] in parts}
    made_later = {path for path in ours if path.split("/")[2] in ("situation", "score")}
    assert set(ours) - made_later == shared
    assert {path: ours[path] for path in shared} == {path: expected[path] for path in shared}

    assert children_of(root) == []
    assert [path for path in root.rglob("*") if path.is_file() and ".staging" in path.parts] == []
    with sqlite3.connect(root / ".prefect" / "prefect.db") as database:
        states = dict(database.execute("select state_type, count(*) from flow_run group by state_type"))
    assert "RUNNING" not in states
    assert states["CRASHED"] == len(KILLED_IN)


def test_a_second_run_on_the_same_root_is_refused(tmp_path: Path) -> None:
    from flows.demo import only_run
    from shared.errors import DomainError

    with only_run(tmp_path), pytest.raises(DomainError, match="Another run"), only_run(tmp_path):
        pass
