"""One request to a provider: limits on time and size, patience with what passes, and a plain word for what does not."""

from __future__ import annotations

import gzip
import time
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import httpx
from tenacity import RetryCallState, Retrying, retry_if_exception, stop_after_attempt, wait_exponential_jitter

from shared.errors import SmokeglintError

_BACKOFF = wait_exponential_jitter(initial=0.5, max=20.0)
_LONGEST_PAUSE_S = 60.0
_sleep = time.sleep
Checked = TypeVar("Checked")


class ProviderError(SmokeglintError):
    """A provider that did not give what was asked. ``passing``: trying again soon can help."""

    def __init__(self, provider: str, reason: str, *, passing: bool = False, retry_after_s: float = 0.0) -> None:
        super().__init__(f"{provider}: {reason}")
        self.provider = provider
        self.reason = reason
        self.passing = passing
        self.retry_after_s = retry_after_s


@dataclass(frozen=True)
class Request:
    """What to ask a provider. Secrets go into ``headers`` or ``form``; ``shown`` is the URL without any."""

    provider: str
    url: str
    headers: Mapping[str, str] = field(default_factory=dict)
    form: Mapping[str, str] | None = None
    shown: str = ""

    @property
    def name(self) -> str:
        return self.shown or self.url


@dataclass(frozen=True)
class Limits:
    """How long and how much: seconds for connecting and between bytes, seconds in all, bytes (also unpacked), tries."""

    connect_s: float = 10.0
    read_s: float = 30.0
    total_s: float = 300.0
    max_bytes: int = 500_000_000
    attempts: int = 4


def fetch(client: httpx.Client, request: Request, limits: Limits | None = None) -> bytes:
    """The content of an answer, whole; ProviderError in a line otherwise. See ``fetch_checked``."""
    return fetch_checked(client, request, lambda content: content, limits)


def fetch_checked(
    client: httpx.Client, request: Request, check: Callable[[bytes], Checked], limits: Limits | None = None
) -> Checked:
    """What ``check`` makes of the content of an answer; ProviderError in a line otherwise.

    Transport errors, 429, 5xx and what the check calls passing are tried again, ever later and at least as late as the
    provider asks.
    """
    chosen = limits or Limits()
    retrying = Retrying(
        retry=retry_if_exception(lambda error: isinstance(error, ProviderError) and error.passing),
        wait=_pause_s,
        stop=stop_after_attempt(chosen.attempts),
        reraise=True,
        sleep=lambda seconds: _sleep(seconds),
    )
    checked: Checked = retrying(lambda: check(_once(client, request, chosen)))
    return checked


def _once(client: httpx.Client, request: Request, limits: Limits) -> bytes:
    timeout = httpx.Timeout(limits.read_s, connect=limits.connect_s)
    method = "POST" if request.form is not None else "GET"
    options = {"headers": dict(request.headers), "timeout": timeout, "follow_redirects": True}
    try:
        with client.stream(method, request.url, data=request.form, **options) as answer:
            _check_status(request, answer)
            return _read(request, answer, limits)
    except httpx.TimeoutException as error:
        raise ProviderError(request.provider, f"no answer in time from {request.name}", passing=True) from error
    except httpx.TransportError as error:
        reason = f"the connection to {request.name} failed: {error or type(error).__name__}"
        raise ProviderError(request.provider, reason, passing=True) from error
    except httpx.HTTPError as error:
        raise ProviderError(request.provider, f"{request.name} cannot be asked: {error}") from error


def _check_status(request: Request, answer: httpx.Response) -> None:
    code = answer.status_code
    if code == (206 if "Range" in request.headers else 200):
        return
    answer.read()
    said = " ".join(answer.text.split())[:200]
    asked = answer.headers.get("Retry-After", "")
    wait_s = float(asked) if asked.isdigit() else 0.0
    if code == 429:
        raise ProviderError(request.provider, f"the quota is used up: {said}", passing=True, retry_after_s=wait_s)
    if code in (401, 403):
        raise ProviderError(request.provider, f"access was refused ({code}): {said}")
    if code >= 500:
        raise ProviderError(request.provider, f"its server failed ({code})", passing=True, retry_after_s=wait_s)
    raise ProviderError(request.provider, f"{request.name} answered {code}: {said}")


def _read(request: Request, answer: httpx.Response, limits: Limits) -> bytes:
    """The body within the limits of size and time; a shorter one than announced is a broken transfer."""
    deadline = time.monotonic() + limits.total_s
    parts, size = [], 0
    for part in answer.iter_bytes():
        parts.append(part)
        size += len(part)
        if size > limits.max_bytes:
            raise ProviderError(request.provider, f"{request.name} is larger than {limits.max_bytes} bytes")
        if time.monotonic() > deadline:
            reason = f"{request.name} took longer than {limits.total_s:.0f} s"
            raise ProviderError(request.provider, reason, passing=True)
    announced = answer.headers.get("Content-Length", "")
    if announced.isdigit() and answer.num_bytes_downloaded != int(announced):
        reason = f"{request.name} was cut off: {answer.num_bytes_downloaded} of {announced} bytes"
        raise ProviderError(request.provider, reason, passing=True)
    return b"".join(parts)


def unpacked(provider: str, content: bytes, max_bytes: int = Limits.max_bytes) -> bytes:
    """The content of a gzip file, or the content itself; ProviderError if it is cut off or larger than allowed."""
    if content[:2] != b"\x1f\x8b":
        return content
    stream = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        plain = stream.decompress(content, max_bytes + 1)
    except (zlib.error, gzip.BadGzipFile) as error:
        raise ProviderError(provider, f"the gzip file is damaged: {error}", passing=True) from error
    if len(plain) > max_bytes:
        raise ProviderError(provider, f"the gzip file unpacks to more than {max_bytes} bytes")
    if not stream.eof:
        raise ProviderError(provider, "the gzip file is cut off", passing=True)
    return plain


def text_of(provider: str, content: bytes) -> str:
    """Text in UTF-8 that is no web page; ProviderError otherwise (login pages and error pages come with status 200)."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ProviderError(provider, f"the answer is not UTF-8 text: {error}") from error
    if text.lstrip()[:15].lower().startswith(("<!doctype", "<html")):
        raise ProviderError(provider, "a web page came instead of data (a login, or an error page)", passing=True)
    return text


def _pause_s(state: RetryCallState) -> float:
    error = state.outcome.exception() if state.outcome else None
    asked = error.retry_after_s if isinstance(error, ProviderError) else 0.0
    return max(_BACKOFF(state), min(asked, _LONGEST_PAUSE_S))
