"""Random kills: ``python -m tests.bench.reliability.chaos --kills 50 --seed 1``, one JSON object a line.

The tiny case runs through five services, Prefect's server and (every second run) PostgreSQL, each a process that is
started again when it ends, as ``restart: unless-stopped`` would. An undisturbed run says in which order steps are
finished and how long each takes. Then kill -9 meets a service, one of its workers, the flow, Prefect's server (with
SQLite: the database) or PostgreSQL, in the middle of one step after the other: the steps and what is killed are drawn
so that none comes twice before all have come once. After each kill every step folder must hold a manifest that
verifies; at the end the artifacts must be those of the undisturbed run, and nothing else may be left.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from flows.runner import flow_code_version
from flows.services import SERVICES
from tests.bench.reliability import traces
from tests.bench.reliability.supervision import REPOSITORY, Platform, Supervisor

OWNERS = {
    "predict-access": "access",
    "forecast-fuel-moisture": "prioritization",
    "rate-active-fires": "prioritization",
    "rate-prefire-danger": "prioritization",
    "build-targets": "prioritization",
    "plan-observations": "planning",
    "check-plan": "planning",
    "simulate-observations": "retrieval",
    "train-soil-moisture": "retrieval",
    "retrieve-burned-area": "retrieval",
    "retrieve-soil-moisture": "retrieval",
    "infer-fire-arrival": "arrival",
}
TARGETS = ("service", "worker", "flow", "prefect", "postgresql")
RUN_LIMIT_S, TURNS = 1500.0, 20


@dataclass(frozen=True)
class Kill:
    """What is killed, and when: ``after_s`` seconds after ``before`` was finished, in the middle of ``step``."""

    target: str
    step: str
    before: str
    after_s: float


@dataclass(frozen=True)
class Reference:
    """The undisturbed run: its artifacts, its steps in order, and the seconds that each took."""

    artifacts: dict[str, str]
    steps: list[str]
    seconds: list[float]
    wall_s: float


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Kill parts of the tiny loop at random moments.")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kills-per-run", type=int, default=6)
    parser.add_argument("--only", type=int, nargs="*", help="only these runs of the plan, to take it in pieces")
    parser.add_argument("--folder", type=Path, default=None, help="where runs are kept; a temporary folder by default")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="smokeglint-chaos-") as scratch:
        folder = (given.folder or Path(scratch)).resolve()
        reference = remembered(folder)
        tell({"undisturbed_s": round(reference.wall_s, 1), "steps": len(reference.steps)})
        results = []
        for number, kills in enumerate(plans(reference, given.kills, given.kills_per_run, given.seed)):
            if given.only is not None and number not in given.only:
                continue
            results.append(trial(folder / f"run-{number:02d}", number, kills, reference))
            tell(results[-1])
        tell(summary(results, reference))
    return 0 if all(result["ok"] for result in results) else 1


def tell(document: dict[str, Any]) -> None:
    print(json.dumps(document), flush=True)


def remembered(folder: Path) -> Reference:
    """The undisturbed run, made in this folder unless this very code has made it there before."""
    file, version = folder / "reference.json", flow_code_version()
    if file.exists() and (kept := json.loads(file.read_bytes()))["version"] == version:
        return Reference(**kept["reference"])
    shutil.rmtree(folder / "reference", ignore_errors=True)
    made = undisturbed(folder / "reference")
    file.write_text(json.dumps({"version": version, "reference": asdict(made)}), encoding="utf-8")
    return made


def undisturbed(root: Path) -> Reference:
    """One run that nobody disturbs."""
    platform = Platform(root, root.with_suffix(".logs"))
    try:
        platform.wait_until_ready()
        begun, clock = time.monotonic(), time.time()
        flow = start_flow(platform)
        if flow.wait(RUN_LIMIT_S) != 0:
            raise RuntimeError(f"the undisturbed run failed; see {root.with_suffix('.logs')}")
        wall_s = time.monotonic() - begun
        order = traces.steps_in_order(root)
        times = [clock, *(written for _, written in order)]
        seconds = [later - earlier for earlier, later in itertools.pairwise(times)]
        return Reference(traces.artifacts(root), [step for step, _ in order], seconds, wall_s)
    finally:
        platform.stop()


def plans(reference: Reference, kills: int, per_run: int, seed: int) -> Iterator[list[Kill]]:
    """The kills of each run, in the order of their steps."""
    draw = random.Random(seed)
    steps, targets = _deck(draw, range(1, len(reference.steps))), _deck(draw, range(len(TARGETS)))
    for first in range(0, kills, per_run):
        postgresql = (first // per_run) % 2 == 1
        chosen = sorted({next(steps) for _ in range(min(per_run, kills - first))})
        made = []
        for index in chosen:
            target = TARGETS[next(targets)]
            target = "prefect" if target == "postgresql" and not postgresql else target
            after_s = draw.random() * reference.seconds[index]
            made.append(Kill(target, reference.steps[index], reference.steps[index - 1], after_s))
        yield made


def _deck(draw: random.Random, cards: Sequence[int]) -> Iterator[int]:
    while True:
        yield from draw.sample(list(cards), len(cards))


def start_flow(platform: Platform) -> subprocess.Popen[bytes]:
    environment = dict(os.environ) | platform.environment
    with (platform.logs / "flow.log").open("ab") as log:
        return subprocess.Popen(platform.flow_command(), cwd=REPOSITORY, env=environment, stdout=log, stderr=log)


def trial(root: Path, number: int, kills: list[Kill], reference: Reference) -> dict[str, Any]:
    """One run with its kills; what it left, held against the undisturbed one."""
    postgresql = number % 2 == 1
    shutil.rmtree(root, ignore_errors=True)
    platform = Platform(root, root.with_suffix(".logs"), postgresql=postgresql)
    done: list[dict[str, Any]] = []
    try:
        platform.wait_until_ready()
        begun, turns, waiting, flow = time.monotonic(), 1, list(kills), start_flow(platform)
        while time.monotonic() < begun + RUN_LIMIT_S and turns <= TURNS:
            if waiting and (root / waiting[0].before / "manifest.json").exists():
                done.append(strike(platform, flow, waiting.pop(0)))
            if flow.poll() is not None:
                if flow.returncode == 0:
                    break
                turns, flow = turns + 1, start_flow(platform)
            time.sleep(0.02)
        wall_s = time.monotonic() - begun
        ended = flow.poll() == 0
        flow.kill()
        platform.wait_until_ready()
        left = _left(platform, reference)
    finally:
        platform.stop()
    left["processes"] = traces.processes_on(root)
    wrong = {name: value for name, value in left.items() if value}
    ok = ended and not wrong and len(done) == len(kills) and not any(kill["half_written"] for kill in done)
    restarts = sum(platform.supervisor.restarts.values())
    database = "postgresql" if postgresql else "sqlite"
    told = {"run": number, "ok": ok, "database": database, "kills": done, "turns": turns, "restarts": restarts}
    return told | {"wall_s": round(wall_s, 1), "extra_s": round(wall_s - reference.wall_s, 1), "wrong": wrong}


def strike(platform: Platform, flow: subprocess.Popen[bytes], kill: Kill) -> dict[str, Any]:
    """Kill at the moment; what was killed, and whether any step folder was half-written just then."""
    time.sleep(kill.after_s)
    name, pid = victim(platform.supervisor, flow, kill)
    os.kill(pid, signal.SIGKILL)
    _, part, step, _ = kill.step.split("/")
    return {"killed": name, "cycle": part, "step": step, "half_written": traces.half_written(platform.root)}


def victim(running: Supervisor, flow: subprocess.Popen[bytes], kill: Kill) -> tuple[str, int]:
    """Name and process of what is to be killed, as it is now."""
    if kill.target == "flow":
        return "flow", flow.pid
    if kill.target not in ("service", "worker"):
        return kill.target, running.pid(kill.target)
    _, part, step, _ = kill.step.split("/")
    service = OWNERS.get(step, SERVICES[len(part + step) % len(SERVICES)])
    pid = running.worker_of(service) if kill.target == "worker" else None
    # A service, or one whose worker is not up just now.
    return (f"{service}-worker", pid) if pid is not None else (f"{service}-service", running.pid(service))


def _left(platform: Platform, reference: Reference) -> dict[str, Any]:
    found = traces.artifacts(platform.root)
    differing = [path for path in found if reference.artifacts.get(path) != found[path]]
    return {
        "missing": sorted(set(reference.artifacts) - set(found)),
        "differing": differing,
        "half_written": traces.half_written(platform.root),
        "staged": traces.staged(platform.root),
        "open_jobs": traces.open_jobs(platform.urls),
        "open_flow_runs": traces.open_flow_runs(platform.environment["PREFECT_API_URL"]),
    }


def summary(results: list[dict[str, Any]], reference: Reference) -> dict[str, Any]:
    kills = [kill for result in results for kill in result["kills"]]
    kinds = [kill["killed"].rsplit("-", 1)[-1] for kill in kills]
    return {
        "kills": len(kills),
        "by_target": {kind: kinds.count(kind) for kind in TARGETS},
        "steps_hit": len({(kill["cycle"], kill["step"]) for kill in kills}),
        "runs": len(results),
        "runs_ok": sum(result["ok"] for result in results),
        "half_written_after_a_kill": sum(len(kill["half_written"]) for kill in kills),
        "undisturbed_s": round(reference.wall_s, 1),
        "extra_s_per_kill": round(sum(result["extra_s"] for result in results) / max(len(kills), 1), 1),
    }


if __name__ == "__main__":
    sys.exit(main())
