"""A request to a provider that is slow, broken, cut off, wordy or tired of us."""

from __future__ import annotations

import gzip

import httpx
import pytest

from flows.ingest.fetching import Limits, ProviderError, Request, fetch, text_of, unpacked
from tests.flows.ingest.provider import Answer, Provider

QUICK = Limits(connect_s=1.0, read_s=0.3, total_s=0.6, attempts=3)


def ask(client: httpx.Client, provider: Provider, limits: Limits = QUICK) -> bytes:
    return fetch(client, Request("Somebody", f"{provider.url}/data"), limits)


def test_what_passes_is_waited_out(client: httpx.Client, provider: Provider, naps: list[float]) -> None:
    tired = Answer(b"slow down", 429, {"Retry-After": "7"})
    provider.tell("/data", Answer(b"oops", 503), tired, b"here it is")
    assert ask(client, provider) == b"here it is"
    assert naps == [0.1, 7.0], "ever later, and as late as the provider asks"


@pytest.mark.parametrize(
    ("answer", "reason", "tries"),
    [
        (Answer(b"", 500), r"its server failed \(500\)", 3),
        (Answer(b"over the limit", 429), "quota is used up: over the limit", 3),
        (Answer(b"cut", announce=100), "the connection .* failed|was cut off", 3),
        (Answer(b"late", pause_s=0.8), "no answer in time", 3),
        (Answer(b"no", 403), r"access was refused \(403\): no", 1),
        (Answer(b"gone", 410), "answered 410: gone", 1),
    ],
)
def test_what_does_not_pass_is_told_in_a_line(
    client: httpx.Client, provider: Provider, answer: Answer, reason: str, tries: int
) -> None:
    provider.tell("/data", answer)
    with pytest.raises(ProviderError, match=f"^Somebody: .*({reason})"):
        ask(client, provider)
    assert provider.count("/data") == tries


def test_nobody_there_is_told_in_a_line(client: httpx.Client) -> None:
    with pytest.raises(ProviderError, match=r"the connection .* failed"):
        fetch(client, Request("Somebody", "http://127.0.0.1:9/data"), QUICK)


def test_an_endless_answer_ends(client: httpx.Client, provider: Provider) -> None:
    provider.tell("/data", b"x" * 5000)
    with pytest.raises(ProviderError, match="larger than 1000 bytes"):
        ask(client, provider, Limits(max_bytes=1000))


def test_secrets_stay_out_of_what_is_told(client: httpx.Client, provider: Provider) -> None:
    request = Request("Somebody", f"{provider.url}/key123/data", shown="http://somebody/…/data")
    with pytest.raises(ProviderError) as caught:
        fetch(client, request, QUICK)
    assert "key123" not in str(caught.value) and "…" in str(caught.value)


def test_packed_content_is_unpacked_within_limits() -> None:
    packed = gzip.compress(b"a" * 100_000)
    assert unpacked("S", packed) == b"a" * 100_000
    assert unpacked("S", b"plain") == b"plain"
    with pytest.raises(ProviderError, match="more than 1000 bytes"):
        unpacked("S", packed, 1000)
    with pytest.raises(ProviderError, match="cut off") as caught:
        unpacked("S", packed[:-20])
    assert caught.value.passing
    with pytest.raises(ProviderError, match="damaged"):
        unpacked("S", packed[:10] + b"\xff" * 40)


def test_only_text_that_is_data_passes() -> None:
    assert text_of("S", "\ufeffa,b".encode()) == "a,b"
    with pytest.raises(ProviderError, match="not UTF-8"):
        text_of("S", "é,b".encode("latin-1"))
    with pytest.raises(ProviderError, match="web page"):
        text_of("S", b"\n<!DOCTYPE html><html>Please log in</html>")
