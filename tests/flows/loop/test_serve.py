"""The loop left running: a scheduled turn goes as far as the clock allows, and ending the process pauses nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

if TYPE_CHECKING:
    from conftest import TinyLoop

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]
REPOSITORY = Path(__file__).resolve().parents[3]
# In a process of its own, since Prefect reads its settings when it is first imported.
WATCH = """
import json, sys, time
from prefect.client.orchestration import get_client
with get_client(sync_client=True) as client:
    deadline = time.monotonic() + 240
    while len(found := client.read_deployments()) < 2 and time.monotonic() < deadline:
        time.sleep(0.2)
    state = ""
    if sys.argv[1:] == ["run"]:
        daily = next(item for item in found if item.entrypoint.endswith("daily_cycle"))
        run = client.create_flow_run_from_deployment(daily.id)
        while not run.state.is_final() and time.monotonic() < deadline:
            time.sleep(0.5)
            run = client.read_flow_run(run.id)
        state = run.state.type.value
    deadline = time.monotonic() + 90
    ahead = set()  # deployments with a run that Prefect has put on its schedule by itself
    while len(ahead) < 2 and time.monotonic() < deadline:
        time.sleep(0.2)
        ahead = {run.deployment_id for run in client.read_flow_runs() if run.state_type.value == "SCHEDULED"}
    schedules = [[schedule.schedule.cron, schedule.active] for item in found for schedule in item.schedules]
    told = {"state": state, "ahead": len(ahead), "paused": [item.paused for item in found]}
    print(json.dumps(told | {"schedules": sorted(schedules)}))
"""


def watch(environment: dict[str, str], *arguments: str) -> dict[str, Any]:
    import json

    command = [sys.executable, "-c", WATCH, *arguments]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=True)
    told: dict[str, Any] = json.loads(said.stdout.splitlines()[-1])
    return told


def test_a_turn_runs_by_itself_and_the_schedules_outlive_their_process(tiny: TinyLoop, tmp_path: Path) -> None:
    script = (
        "import sys, time; from pathlib import Path; from flows.prefect_server import running_prefect_server\n"
        "with running_prefect_server(Path(sys.argv[1])) as url:\n    print(url, flush=True); sys.stdin.read()"
    )
    base = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, "-c", script, str(tmp_path)]
    server = subprocess.Popen(command, env=base, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None and server.stdin is not None
    url = server.stdout.readline().strip()
    clock = {"SMOKEGLINT_CLOCK": "2025-09-01T12:30:00+00:00", "PREFECT_API_URL": url, "PREFECT_HOME": str(tmp_path)}
    services = ",".join(f"{name}={address}" for name, address in tiny.urls.items())
    options = ["--case", "tiny", "--root", str(tiny.root), "--services", services]
    log = (tmp_path / "serve.log").open("wb")
    try:
        answering(f"{url}/health")
        serve = [sys.executable, "-m", "flows.commands", "serve", *options]
        serving = subprocess.Popen(serve, env=base | clock, cwd=REPOSITORY, stdout=log, stderr=log)
        told = watch(base | clock, "run")
        assert told["schedules"] == [["20 * * * *", True], ["5 12 * * *", True]]
        assert told["ahead"] == 2, "both schedules have their next runs, made by nobody's hand"
        assert told["state"] == "COMPLETED", (tmp_path / "serve.log").read_text()[-3000:]
        assert "is being executed until 2025-09-02 12:00 UTC" in (tmp_path / "serve.log").read_text()
        serving.send_signal(signal.SIGTERM)
        assert serving.wait(60) == 0
        after = watch(base | clock)
        assert after["paused"] == [False, False] and after["schedules"] == told["schedules"]
    finally:
        serving.kill()
        server.stdin.close()
        server.wait(30)
        log.close()


def answering(url: str, limit_s: float = 120.0) -> None:
    deadline = time.monotonic() + limit_s
    while time.monotonic() < deadline:
        try:
            if httpx.get(url, timeout=5).status_code == 200:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    raise AssertionError(f"nobody answers at {url}")
