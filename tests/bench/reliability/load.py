"""Many readers at once: ``python -m tests.bench.reliability.load``, one JSON object a line.

Each service in turn, one real process with API keys in force and a register of 1,000 jobs, is asked by 50 and then by
200 clients at once. Each client asks for one page after the other without a pause, over a connection of its own, as
long as the requests last; pages are drawn from those that read. Given are the median, the 95th percentile and the
longest answer in milliseconds, and how many answers were not 200. Clients and service share the machine.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import random
import sqlite3
import sys
import tempfile
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil

from flows.services import SERVICES
from shared.client import ProcessClient
from shared.process.jobs import JobRegister, JobRequest
from shared.security.api_keys import add_key
from tests.bench.reliability.supervision import Supervisor, service_process
from tests.shared.servers import free_port

BARS = {50: 100.0, 200: 500.0}
JOBS = 1000
REFERENCE = {
    "href": "file:///data/artifacts/case/20250901T1200Z/step/0123456789abcdef/table.parquet",
    "sha256": "0" * 64,
}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Ask each service by many clients at once.")
    parser.add_argument("--clients", type=int, nargs="*", default=sorted(BARS))
    parser.add_argument("--requests", type=int, default=3000, help="at each number of clients")
    parser.add_argument("--services", nargs="*", default=list(SERVICES), choices=SERVICES)
    parser.add_argument("--by-page", action="store_true", help="tell of each page, too")
    given = parser.parse_args(arguments)
    met = True
    for service in given.services:
        with tempfile.TemporaryDirectory(prefix="smokeglint-load-") as folder:
            for told in measure(service, Path(folder), given.clients, given.requests, given.by_page):
                met &= told.get("ok", True)
                print(json.dumps(told), flush=True)
    return 0 if met else 1


def measure(service: str, root: Path, clients: Sequence[int], requests: int, by_page: bool) -> list[dict[str, Any]]:
    """The answers of one service to so many clients at once."""
    key = add_key(root / "keys.json", "load", ("read",))
    job = fill_register(root, service)
    port, supervisor = free_port(), Supervisor(root / "logs")
    keys = {f"SMOKEGLINT_{service.upper()}_API_KEYS": str(root / "keys.json")}
    supervisor.add(service, *service_process(service, root, port, keys))
    url, told = f"http://127.0.0.1:{port}", []
    try:
        with ProcessClient(url) as client:
            client.wait_ready()
        pages = pages_of(url, key, job)
        asyncio.run(ask(port, key, pages, 10, 200))  # the first answers pay for imports and connections
        for number in clients:
            before_s = _cpu_s(supervisor.pid(service))
            seconds, failed, wall_s = asyncio.run(ask(port, key, pages, number, requests))
            cpu_ms = 1000.0 * (_cpu_s(supervisor.pid(service)) - before_s) / requests
            told += [summary(service, number, seconds, failed, wall_s) | {"service_cpu_ms": round(cpu_ms, 2)}]
            told += [_of_page(service, number, page, seconds[page]) for page in pages if by_page]
    finally:
        supervisor.stop()
    return told


def fill_register(root: Path, service: str) -> str:
    """A register as a service has it after weeks: the id of its newest job, which was successful."""
    (root / ".jobs").mkdir(parents=True)
    register = JobRegister(f"sqlite:///{root / '.jobs' / f'{service}.sqlite'}")
    inputs = {f"input_{number}": REFERENCE for number in range(8)}
    job, _ = register.submit(JobRequest("process", inputs, "hash", None, "case-cycle", "flow"))
    register.update(job.id, "successful", progress=100.0, outputs={f"output_{n}": REFERENCE for n in range(6)})
    register.close()
    with contextlib.closing(sqlite3.connect(root / ".jobs" / f"{service}.sqlite")) as database, database:
        first = list(database.execute("SELECT * FROM jobs").fetchone())  # id and sequence lead the columns
        copies = [[uuid.uuid4().hex, number, *first[2:]] for number in range(2, JOBS + 1)]
        database.executemany(f"INSERT INTO jobs VALUES ({', '.join('?' * len(first))})", copies)
    return str(copies[-1][0])


def pages_of(url: str, key: str, job: str) -> list[str]:
    """Every page that reads: landing, processes and one of them, jobs, one job and its results, metrics, health."""
    listed = httpx.get(f"{url}/processes", headers={"Authorization": f"Bearer {key}"}).json()["processes"]
    process = f"/processes/{listed[0]['id']}"
    jobs = ["/jobs", f"/jobs/{job}", f"/jobs/{job}/results"]
    return ["/", "/conformance", "/processes", process, *jobs, "/metrics", "/readyz"]


async def ask(
    port: int, key: str, pages: Sequence[str], clients: int, requests: int
) -> tuple[dict[str, list[float]], int, float]:
    """Seconds of each answer by page, how many were not 200, and the seconds it took in all."""
    seconds: dict[str, list[float]] = {page: [] for page in pages}
    draw = random.Random(clients)
    waiting = [draw.choice(pages) for _ in range(requests)]
    failed = 0

    async def one() -> None:
        nonlocal failed
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        while waiting:
            page, begun = waiting.pop(), time.perf_counter()
            failed += await _status(reader, writer, page, key) != 200
            seconds[page].append(time.perf_counter() - begun)
        writer.close()

    begun = time.perf_counter()
    await asyncio.gather(*(one() for _ in range(clients)))
    return seconds, failed, time.perf_counter() - begun


async def _status(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, page: str, key: str) -> int:
    """The status of a GET, its answer read to the end. By hand: a client library would take longer than the service."""
    writer.write(f"GET {page} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {key}\r\n\r\n".encode())
    head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
    await reader.readexactly(int(head.split("content-length:")[1].split("\r\n")[0]))
    return int(head.split(" ")[1])


def summary(service: str, clients: int, seconds: dict[str, list[float]], failed: int, wall_s: float) -> dict[str, Any]:
    every = [value for values in seconds.values() for value in values]
    p95 = _ms(np.percentile(every, 95))
    return {
        "service": service,
        "clients": clients,
        "requests": len(every),
        "failed": failed,
        "p50_ms": _ms(np.percentile(every, 50)),
        "p95_ms": p95,
        "longest_ms": _ms(max(every)),
        "per_s": round(len(every) / wall_s),
        "ok": failed == 0 and p95 < BARS.get(clients, float("inf")),
    }


def _of_page(service: str, clients: int, page: str, seconds: list[float]) -> dict[str, Any]:
    named = "/".join(part[:20] for part in page.split("/"))
    return {"service": service, "clients": clients, "page": named, "p95_ms": _ms(np.percentile(seconds, 95))}


def _cpu_s(pid: int) -> float:
    """Processor time of a process so far: what a request costs, whoever else is at work."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def _ms(seconds: Any) -> float:
    return round(1000.0 * float(seconds), 1)


if __name__ == "__main__":
    sys.exit(main())
