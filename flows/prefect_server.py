"""Prefect without a server to look after: one of our own for the time of a run, without a user interface.

Prefect's ephemeral server outlives a killed flow. This one is a child that ends with its parent, keeps its database
under the work folder of the artifact root, and so lets the next run find and close what a killed run left as Running.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flows.root import ArtifactRoot, work_folder
from flows.services import end_process
from shared.errors import SmokeglintError
from shared.telemetry import logger


def prefect_environment(root: ArtifactRoot) -> dict[str, str]:
    """Prefect's settings for a run: its home in the root's work folder, nothing sent anywhere, only warnings logged."""
    home = work_folder(root) / ".prefect"
    return {
        "PREFECT_HOME": str(home),
        "PREFECT_API_DATABASE_CONNECTION_URL": f"sqlite+aiosqlite:///{home / 'prefect.db'}",
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "PREFECT_SERVER_UI_ENABLED": "false",
        "PREFECT_LOGGING_LEVEL": "WARNING",
        "PREFECT_LOGGING_SERVER_LEVEL": "ERROR",
        "PREFECT_LOGGING_TO_API_ENABLED": "false",
        "PREFECT_CLI_PROMPT": "false",
        "DO_NOT_TRACK": "1",
    }


def await_prefect(api_url: str, wait_s: float = 300.0) -> None:
    """Wait for a Prefect server that comes up after us; SmokeglintError if it does not within ``wait_s``."""
    import httpx
    from tenacity import Retrying, retry_if_exception_type, stop_after_delay, wait_exponential

    def ask() -> None:
        httpx.get(f"{api_url.rstrip('/')}/health", timeout=5.0).raise_for_status()

    patiently = Retrying(
        retry=retry_if_exception_type(httpx.HTTPError),
        wait=wait_exponential(0.5, max=10.0),
        stop=stop_after_delay(wait_s),
        before_sleep=lambda _: logger().warning("waiting for Prefect's server", url=api_url),
        reraise=True,
    )
    try:
        patiently(ask)
    except httpx.HTTPError as error:
        raise SmokeglintError(f"Prefect's server at {api_url} does not answer: {error}") from error


@contextmanager
def running_prefect_server(root: ArtifactRoot) -> Iterator[str]:
    """Start the server; yields the API's URL for PREFECT_API_URL. Must surround the first import of prefect."""
    os.environ.update(prefect_environment(root))
    home = work_folder(root) / ".prefect"
    home.mkdir(parents=True, exist_ok=True)
    with socket.socket() as listener, (home / "server.log").open("ab") as log:
        listener.bind(("127.0.0.1", 0))
        listener.listen(128)
        port = listener.getsockname()[1]
        process = subprocess.Popen(
            [sys.executable, "-m", "flows.prefect_server", str(listener.fileno()), str(os.getpid())],
            cwd=Path(__file__).resolve().parents[1],
            pass_fds=(listener.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )
        listener.close()
        try:
            url = f"http://127.0.0.1:{port}/api"
            os.environ["PREFECT_API_URL"] = url
            yield url
        finally:
            end_process(process)


def _serve(descriptor: int, parent_pid: int) -> None:
    import uvicorn

    from shared.lifeline import end_with_parent

    end_with_parent(parent_pid)
    config = {"factory": True, "fd": descriptor, "log_level": "error"}
    uvicorn.run("prefect.server.api.server:create_app", **config)


if __name__ == "__main__":
    _serve(int(sys.argv[1]), int(sys.argv[2]))
