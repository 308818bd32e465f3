"""A local server that plays a provider: what it answers to each path is said beforehand, faults included."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Answer:
    """One answer. ``announce`` states more bytes than are sent; ``pause_s`` waits before the body."""

    body: bytes = b""
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    announce: int = 0
    pause_s: float = 0.0


@dataclass
class Provider:
    """Answers by path (without query): the next of its list, the last one again and again."""

    url: str = ""
    answers: dict[str, list[Answer]] = field(default_factory=dict)
    asked: list[tuple[str, str, dict[str, str], bytes]] = field(default_factory=list)

    def tell(self, path: str, *answers: Answer | bytes) -> None:
        self.answers[path] = [item if isinstance(item, Answer) else Answer(item) for item in answers]

    def count(self, path: str) -> int:
        return sum(asked.partition("?")[0] == path for _, asked, _, _ in self.asked)


@contextmanager
def running_provider() -> Iterator[Provider]:
    provider = Provider()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer(b"")

        def do_POST(self) -> None:
            self._answer(self.rfile.read(int(self.headers.get("Content-Length", 0))))

        def _answer(self, body: bytes) -> None:
            provider.asked.append((self.command, self.path, dict(self.headers), body))
            listed = provider.answers.get(self.path.partition("?")[0], [Answer(b"Not here", 404)])
            answer = listed.pop(0) if len(listed) > 1 else listed[0]
            content, status = answer.body, answer.status
            if "Range" in self.headers and status == 200:
                first, _, last = self.headers["Range"].removeprefix("bytes=").partition("-")
                content, status = content[int(first) : int(last) + 1 if last else None], 206
            self.send_response(status)
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(answer.announce or len(content)))
            self.end_headers()
            time.sleep(answer.pause_s)
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

        def handle_one_request(self) -> None:
            try:
                super().handle_one_request()
            except (BrokenPipeError, ConnectionResetError):
                self.close_connection = True

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    provider.url = f"http://127.0.0.1:{server.server_address[1]}"
    threading.Thread(target=lambda: server.serve_forever(poll_interval=0.02), daemon=True).start()
    try:
        yield provider
    finally:
        server.shutdown()
        server.server_close()
