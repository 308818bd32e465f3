"""The five services as separate processes on free loopback ports, ended with the flow that started them."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from flows.root import ArtifactRoot, named_root, work_folder
from shared.client import ProcessClient

SERVICES = ("access", "prioritization", "planning", "retrieval", "arrival")
_REPOSITORY = Path(__file__).resolve().parents[1]


@contextmanager
def running_services(
    root: ArtifactRoot, read_roots: tuple[Path, ...] = (), logs: Path | None = None
) -> Iterator[dict[str, str]]:
    """Start the services over one artifact root; yields the base URL of each, and ends them afterwards.

    Each listens on a socket that is bound here and handed down, so no port can be lost between choosing and using it.
    Logs go to ``logs/<service>.log``.
    """
    folder = logs or work_folder(root) / ".logs"
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        urls = {
            name: stack.enter_context(_service(name, root, read_roots, folder / f"{name}.log")) for name in SERVICES
        }
        yield urls


def wait_until_ready(urls: Mapping[str, str], limit_s: float = 180.0) -> None:
    """Wait for every service; TimeoutError names the one that does not come up."""
    for name, url in urls.items():
        with ProcessClient(url) as client:
            try:
                client.wait_ready(limit_s)
            except TimeoutError as error:
                raise TimeoutError(f"the {name} service did not come up; see its log ({error})") from error


@contextmanager
def _service(name: str, root: ArtifactRoot, read_roots: tuple[Path, ...], log: Path) -> Iterator[str]:
    with socket.socket() as listener, log.open("ab") as stream:
        listener.bind(("127.0.0.1", 0))
        listener.listen(128)
        port = listener.getsockname()[1]
        command = [sys.executable, "-m", "uvicorn", f"services.{name}.app:app", "--fd", str(listener.fileno())]
        process = subprocess.Popen(
            [*command, "--log-level", "warning", "--no-access-log"],
            cwd=_REPOSITORY,
            env=os.environ | _environment(name, root, read_roots),
            pass_fds=(listener.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=stream,
        )
        listener.close()  # the service holds it now
        try:
            yield f"http://127.0.0.1:{port}"
        finally:
            end_process(process)


def _environment(name: str, root: ArtifactRoot, read_roots: tuple[Path, ...]) -> dict[str, str]:
    prefix = f"SMOKEGLINT_{name.upper()}_"
    quoted = ", ".join(f'"{path}"' for path in read_roots)
    return {
        prefix + "ARTIFACT_ROOT": named_root(root),
        prefix + "JOB_DATABASE": _job_database(name, root),
        prefix + "READ_ROOTS": f"[{quoted}]",
        prefix + "PARENT_PID": str(os.getpid()),
        "PYTHONPATH": str(_REPOSITORY),
        **process_environment(),
    }


def _job_database(name: str, root: ArtifactRoot) -> str:
    """The job register of a service of ours: as the operator set it, else a file in the root's work folder."""
    for variable in (f"SMOKEGLINT_{name.upper()}_JOB_DATABASE", "SMOKEGLINT_SERVICE_JOB_DATABASE"):
        if chosen := os.environ.get(variable):
            return chosen
    folder = work_folder(root) / ".jobs"
    folder.mkdir(parents=True, exist_ok=True)
    return f"sqlite:///{folder / name}.sqlite"


def process_environment() -> dict[str, str]:
    """What the libraries behind the processes must be told before they are loaded."""
    return {
        "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", str(_REPOSITORY / ".cache" / "numba")),
        "OMP_WAIT_POLICY": "PASSIVE",
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "2"),
        "MPLBACKEND": "Agg",
    }


def end_process(process: subprocess.Popen[bytes]) -> None:
    """Ask a child to end, and insist after ten seconds."""
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
