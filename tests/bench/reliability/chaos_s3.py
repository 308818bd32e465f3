"""Random kills on S3: ``python -m tests.bench.reliability.chaos_s3 --kills 8``, one JSON object a line.

The tiny case runs with its root on an S3 server (moto's, a process of its own), through five services and Prefect's
server, each started again when it ends. Kill -9 meets the flow, the service at work or its worker in turn, while one
step after the other is made. A killed flow leaves its lock: the next turn must take it over once its lease is over.
After each kill every manifest that is to be seen must verify, with all files that it names; files without a manifest
may lie there, and count as nothing. At the end the bytes must be those of an undisturbed run in a folder.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fsspec

from flows.prefect_server import prefect_environment
from flows.root import WORK, store_of
from flows.root_lock import LOCK
from flows.services import SERVICES
from shared.artifacts.manifest import MANIFEST
from tests.bench.reliability import traces
from tests.bench.reliability.chaos import RUN_LIMIT_S, TURNS, Kill, Reference, remembered, tell, victim
from tests.bench.reliability.supervision import REPOSITORY, Supervisor, answers, service_process
from tests.shared.servers import S3_ENVIRONMENT, free_port, s3_server

TARGETS = ("flow", "service", "worker")
ROOT = "s3://smokeglint/artifacts"
TAKEN_OVER = "took over the lock"


class S3Platform:
    """The five services and Prefect's server under a supervisor; artifacts on the S3 server of the environment."""

    def __init__(self, folder: Path) -> None:
        self.logs = folder / "logs"
        self.supervisor = Supervisor(self.logs)
        self.urls = {name: self._service(name, folder) for name in SERVICES}
        port = free_port()
        prefect = prefect_environment(ROOT)
        Path(prefect["PREFECT_HOME"]).mkdir(parents=True, exist_ok=True)
        app = ["--factory", "prefect.server.api.server:create_app", "--host", "127.0.0.1", "--port", str(port)]
        self.supervisor.add("prefect", [sys.executable, "-m", "uvicorn", *app, "--log-level", "error"], prefect)
        clock = {"SMOKEGLINT_CLOCK": "2025-09-10T00:00:00+00:00", "PYTHONPATH": str(REPOSITORY)}
        self.environment = prefect | clock | {"PREFECT_API_URL": f"http://127.0.0.1:{port}/api"}

    def _service(self, name: str, folder: Path) -> str:
        port, database = free_port(), f"sqlite:///{folder / name}.sqlite"
        given = {f"SMOKEGLINT_{name.upper()}_JOB_DATABASE": database}
        self.supervisor.add(name, *service_process(name, ROOT, port, given))
        return f"http://127.0.0.1:{port}"

    def wait_until_ready(self, limit_s: float = 600.0) -> None:
        asked = [f"{url}/readyz" for url in self.urls.values()] + [self.environment["PREFECT_API_URL"] + "/health"]
        deadline = time.monotonic() + limit_s
        while not all(answers(url) for url in asked):
            if time.monotonic() > deadline:
                raise TimeoutError(f"not all of the services came up within {limit_s:.0f} s")
            time.sleep(0.5)

    def start_flow(self) -> subprocess.Popen[bytes]:
        named = ",".join(f"{name}={url}" for name, url in self.urls.items())
        command = [sys.executable, "-m", "flows.commands", "serve", "--case", "tiny", "--root", ROOT]
        with (self.logs / "flow.log").open("ab") as log:
            environment = dict(os.environ) | self.environment
            given: dict[str, Any] = {"cwd": REPOSITORY, "env": environment, "stdout": log, "stderr": log}
            return subprocess.Popen([*command, "--services", named, "--once"], **given)

    def taken_over(self) -> int:
        """How often a turn took over the lock of a killed one."""
        return (self.logs / "flow.log").read_text(errors="replace").count(TAKEN_OVER)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Kill parts of the tiny loop while its artifacts lie on S3.")
    parser.add_argument("--kills", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=None, help="where the undisturbed run is kept")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="smokeglint-chaos-s3-") as scratch, s3_server() as url:
        reference = remembered((given.folder or Path(scratch)).resolve())
        os.environ.update(S3_ENVIRONMENT | {"AWS_ENDPOINT_URL": url, WORK: str(Path(scratch) / "work")})
        fsspec.filesystem("s3").mkdir("smokeglint")
        told = trial(S3Platform(Path(scratch)), drawn(reference, given.kills, given.seed), reference)
    tell(told)
    return 0 if told["ok"] else 1


def drawn(reference: Reference, kills: int, seed: int) -> list[Kill]:
    """The kills in the order of their steps, no step twice, the targets in turn."""
    draw = random.Random(seed)
    chosen = sorted(draw.sample(range(1, len(reference.steps)), kills))
    steps, seconds = reference.steps, reference.seconds
    return [
        Kill(TARGETS[number % len(TARGETS)], steps[index], steps[index - 1], draw.random() * seconds[index])
        for number, index in enumerate(chosen)
    ]


def trial(platform: S3Platform, kills: list[Kill], reference: Reference) -> dict[str, Any]:
    """One run with its kills; what it left, held against the undisturbed one."""
    done: list[dict[str, Any]] = []
    remote = fsspec.filesystem("s3", use_listings_cache=False)
    try:
        platform.wait_until_ready()
        begun, turns, waiting, flow = time.monotonic(), 1, list(kills), platform.start_flow()
        while time.monotonic() < begun + RUN_LIMIT_S and turns <= TURNS:
            if waiting and remote.exists(f"{ROOT}/{waiting[0].before}/{MANIFEST}"):
                done.append(strike(platform, flow, waiting.pop(0)))
            if flow.poll() is not None:
                if flow.returncode == 0:
                    break
                turns, flow = turns + 1, platform.start_flow()
            time.sleep(0.1)
        ended, wall_s = flow.poll() == 0, time.monotonic() - begun
        flow.kill()
        platform.wait_until_ready()
        left = _left(platform, remote, reference)
        taken_over = platform.taken_over()
    finally:
        platform.supervisor.stop()
    wrong = {name: value for name, value in left.items() if value}
    flows_killed = sum(kill["killed"] == "flow" for kill in done)
    ok = ended and not wrong and len(done) == len(kills) and not any(kill["unverified"] for kill in done)
    told = {"ok": ok and taken_over == flows_killed, "kills": done, "turns": turns, "locks_taken_over": taken_over}
    return told | {"restarts": sum(platform.supervisor.restarts.values()), "wall_s": round(wall_s, 1), "wrong": wrong}


def strike(platform: S3Platform, flow: subprocess.Popen[bytes], kill: Kill) -> dict[str, Any]:
    """Kill at the moment; what was killed, and which manifests did not verify just then."""
    time.sleep(kill.after_s)
    name, pid = victim(platform.supervisor, flow, kill)
    os.kill(pid, signal.SIGKILL)
    _, part, step, _ = kill.step.split("/")
    return {"killed": name, "cycle": part, "step": step, "unverified": unverified()}


def unverified() -> list[str]:
    """Steps with a manifest whose files are not all there and right."""
    fsspec.filesystem("s3").invalidate_cache()
    store = store_of(ROOT)
    return [address.path for address in store.addresses(traces.CASE) if store.load(address) is None]


def _left(platform: S3Platform, remote: Any, reference: Reference) -> dict[str, Any]:
    contents = remote.cat(remote.find(f"{ROOT}/{traces.CASE}"))
    base = ROOT.removeprefix("s3://") + "/"
    found = {path.removeprefix(base): hashlib.sha256(content).hexdigest() for path, content in contents.items()}
    return {
        "missing": sorted(set(reference.artifacts) - set(found)),
        "differing": [path for path in found if reference.artifacts.get(path) != found[path]],
        "unverified": unverified(),
        "locked": remote.exists(f"{ROOT}/{LOCK}"),
        "open_jobs": traces.open_jobs(platform.urls),
        "open_flow_runs": traces.open_flow_runs(platform.environment["PREFECT_API_URL"]),
    }


if __name__ == "__main__":
    sys.exit(main())
