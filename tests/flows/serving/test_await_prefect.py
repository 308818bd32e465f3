"""A process that serves the schedules waits for a Prefect server that comes up after it."""

from __future__ import annotations

import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from flows.prefect_server import await_prefect
from shared.errors import SmokeglintError
from tests.shared.servers import free_port


class Health(BaseHTTPRequestHandler):
    """Not ready when first asked, then alive."""

    asked: list[str] = []  # noqa: RUF012 - emptied by the test

    def do_GET(self) -> None:
        self.asked.append(self.path)
        self.send_response(200 if len(self.asked) > 1 else 503)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


def test_it_is_waited_for_until_it_is_healthy() -> None:
    port = free_port()
    Health.asked.clear()
    waiting = threading.Thread(target=await_prefect, args=(f"http://127.0.0.1:{port}/api", 30.0))
    waiting.start()
    time.sleep(0.3)
    assert waiting.is_alive()
    server = HTTPServer(("127.0.0.1", port), Health)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    waiting.join(20)
    server.shutdown()
    server.server_close()
    assert not waiting.is_alive() and Health.asked == ["/api/health", "/api/health"]


def test_one_that_never_comes_up_is_named() -> None:
    with pytest.raises(SmokeglintError, match="does not answer"):
        await_prefect(f"http://127.0.0.1:{free_port()}/api", wait_s=0.0)
