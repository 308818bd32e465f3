"""Processes as an operator's process manager keeps them: whatever ends is started again, until all is stopped."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import httpx
import psutil

from flows.prefect_server import prefect_environment
from flows.services import SERVICES
from tests.shared.servers import as_other_user, free_port

REPOSITORY = Path(__file__).resolve().parents[3]
_LOOK_S = 0.1


class Supervisor:
    """Named processes, each restarted when it ends; ``restarts`` counts how often."""

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._commands: dict[str, tuple[Sequence[str], Mapping[str, str]]] = {}
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self.restarts: dict[str, int] = {}
        logs.mkdir(parents=True, exist_ok=True)
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def add(self, name: str, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        """Start a process and keep it running."""
        with self._lock:
            self._commands[name] = (command, dict(os.environ) | dict(environment or {}))
            self.restarts[name] = 0
            self._running[name] = self._start(name)

    def pid(self, name: str) -> int:
        """The process of that name as it is now."""
        with self._lock:
            return self._running[name].pid

    def worker_of(self, name: str) -> int | None:
        """A worker process of a service, or None if it has none just now."""
        try:
            children = psutil.Process(self.pid(name)).children()
            workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
            return int(workers[0].pid) if workers else None
        except psutil.Error:
            return None

    def stop(self) -> None:
        """End all, the last started first."""
        self._stopped.set()
        self._watcher.join()
        for process in reversed(self._running.values()):
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self, name: str) -> subprocess.Popen[bytes]:
        command, environment = self._commands[name]
        log = self._logs / f"{name}.log"
        with log.open("ab") as stream:
            folder = "/" if name == "postgresql" else REPOSITORY
            given: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": stream, "stderr": stream}
            return subprocess.Popen(command, env=dict(environment), cwd=folder, **given)

    def _watch(self) -> None:
        while not self._stopped.wait(_LOOK_S):
            with self._lock:
                for name, process in self._running.items():
                    if process.poll() is not None and not self._stopped.is_set():
                        self.restarts[name] += 1
                        self._running[name] = self._start(name)


class Platform:
    """The five services and Prefect's server under a supervisor, their databases SQLite or one PostgreSQL."""

    def __init__(self, root: Path, logs: Path, *, postgresql: bool = False, workers: int = 1) -> None:
        root.mkdir(parents=True, exist_ok=True)
        self.root, self.logs = root, logs
        self.supervisor = Supervisor(logs)
        self._data: Path | None = None
        database = self._postgresql() if postgresql else ""
        self.urls = {name: self._service(name, database, workers) for name in SERVICES}
        self.environment = self._prefect(database)

    def wait_until_ready(self, limit_s: float = 600.0) -> None:
        """Wait for the services and Prefect's server; TimeoutError if one does not come up."""
        asked = [f"{url}/readyz" for url in self.urls.values()] + [self.environment["PREFECT_API_URL"] + "/health"]
        deadline = time.monotonic() + limit_s
        for url in asked:
            while not answers(url):
                if time.monotonic() > deadline:
                    raise TimeoutError(f"{url} did not come up within {limit_s:.0f} s")
                time.sleep(0.2)

    def flow_command(self) -> list[str]:
        """All that is due of the tiny case, in one turn."""
        services = ",".join(f"{name}={url}" for name, url in self.urls.items())
        options = ["--case", "tiny", "--root", str(self.root), "--services", services, "--once"]
        return [sys.executable, "-m", "flows.commands", "serve", *options]

    def stop(self) -> None:
        self.supervisor.stop()
        if self._data is not None:
            shutil.rmtree(self._data, ignore_errors=True)

    def _service(self, name: str, database: str, workers: int) -> str:
        port = free_port()
        environment = {
            f"SMOKEGLINT_{name.upper()}_JOB_DATABASE": database.replace("/postgres", f"/{name}"),
            f"SMOKEGLINT_{name.upper()}_WORKERS": str(workers),
        }
        self.supervisor.add(name, *service_process(name, self.root, port, environment))
        return f"http://127.0.0.1:{port}"

    def _prefect(self, database: str) -> dict[str, str]:
        port = free_port()
        environment = prefect_environment(self.root)
        if database:
            url = database.replace("+psycopg", "+asyncpg").replace("/postgres", "/prefect")
            environment["PREFECT_API_DATABASE_CONNECTION_URL"] = url
        (self.root / ".prefect").mkdir(exist_ok=True)
        app = ["--factory", "prefect.server.api.server:create_app", "--host", "127.0.0.1", "--port", str(port)]
        command = [sys.executable, "-m", "uvicorn", *app, "--log-level", "error"]
        self.supervisor.add("prefect", command, environment)
        clock = {"SMOKEGLINT_CLOCK": "2025-09-10T00:00:00+00:00", "PYTHONPATH": str(REPOSITORY)}
        return environment | clock | {"PREFECT_API_URL": f"http://127.0.0.1:{port}/api"}

    def _postgresql(self) -> str:
        """A PostgreSQL server of our own with a database a service and one for Prefect."""
        program = sorted(Path("/usr/lib/postgresql").glob("*/bin/postgres"))[-1]
        folder = self._data = Path(tempfile.mkdtemp(prefix="smokeglint-postgresql-"))
        as_user = as_other_user(folder)
        initdb = [program.with_name("initdb"), "-D", folder / "data", "-U", "smokeglint", "--auth=trust", "-N"]
        subprocess.run([*as_user, *initdb], check=True, capture_output=True, cwd="/")
        port = free_port()
        options = ["-p", str(port), "-h", "127.0.0.1", "-k", str(folder), "-c", "max_connections=200"]
        self.supervisor.add("postgresql", [*as_user, str(program), "-D", str(folder / "data"), *options])
        url = f"postgresql://smokeglint@127.0.0.1:{port}/postgres"
        _create_databases(url, (*SERVICES, "prefect"))
        return url.replace("postgresql:", "postgresql+psycopg:")


def service_process(
    name: str, root: Path | str, port: int, environment: Mapping[str, str] | None = None
) -> tuple[list[str], dict[str, str]]:
    """The command and environment of a service on a port, over an artifact root."""
    prefix = f"SMOKEGLINT_{name.upper()}_"
    given = {
        prefix + "ARTIFACT_ROOT": str(root),
        prefix + "PARENT_PID": str(os.getpid()),
        "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", str(REPOSITORY / ".cache" / "numba")),
        "MPLBACKEND": "Agg",
    }
    options = ["--host", "127.0.0.1", "--port", str(port), "--log-level", "warning", "--no-access-log"]
    return [sys.executable, "-m", "uvicorn", f"services.{name}.app:app", *options], given | dict(environment or {})


def _create_databases(url: str, names: Sequence[str]) -> None:
    import psycopg

    deadline = time.monotonic() + 60
    while True:
        try:
            with psycopg.connect(url, autocommit=True) as connection:
                for name in names:
                    connection.execute(f'CREATE DATABASE "{name}"')
            return
        except psycopg.OperationalError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=5).status_code == 200
    except httpx.TransportError:
        return False
