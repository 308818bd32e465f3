"""From offers to a file: their order, what is kept, and when old data do and do not do."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest

from flows.ingest.fetching import Limits, ProviderError, Request
from flows.ingest.taking import Checked, Offer, Source, StaleSourceError, kept_files, take
from tests.flows.ingest.provider import Answer, Provider

NOW = datetime(2026, 7, 1, 12, tzinfo=UTC)


def check(content: bytes) -> Checked:
    """Data that say how many hours before NOW they are of."""
    if not content.strip(b"-").isdigit():
        raise ProviderError("Somebody", f"no number: {content!r}")
    return Checked(content, NOW - timedelta(hours=int(content)))


def source(provider: Provider) -> Source:
    offers = [Offer(Request(name, f"{provider.url}/{name}"), check) for name in ("first", "second")]
    return Source("hours", ".txt", offers, timedelta(hours=24), Limits(attempts=2))


def test_the_first_offer_that_holds_is_taken(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    provider.tell("/first", Answer(b"", 500))
    provider.tell("/second", b"3")
    taken = take(source(provider), tmp_path, NOW, client)
    assert (taken.provider, taken.fresh, taken.path.read_bytes()) == ("second", True, b"3")
    assert taken.age(NOW) == timedelta(hours=3)
    assert taken.problems == ("first: its server failed (500)",)


def test_without_any_offer_the_newest_kept_does_and_it_is_said(
    tmp_path: Path, client: httpx.Client, provider: Provider
) -> None:
    provider.tell("/first", b"3", b"gone", b"gone")
    provider.tell("/second", Answer(b"", 404))
    first = take(source(provider), tmp_path, NOW, client)
    again = take(source(provider), tmp_path, NOW + timedelta(hours=20), client)
    assert (again.path, again.fresh) == (first.path, False)
    assert [problem.split(":")[0] for problem in again.problems] == ["Somebody", "second"]
    told = r"hours: what is kept is of 2026-07-01 09:00 UTC, .* 24 h old at most\. .*no number"
    with pytest.raises(StaleSourceError, match=told):
        take(source(provider), tmp_path, NOW + timedelta(hours=22), client)


def test_nothing_kept_and_nothing_offered_is_an_end(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    with pytest.raises(StaleSourceError, match=r"hours: nothing is kept, .*answered 404"):
        take(source(provider), tmp_path, NOW, client)
    assert not list(tmp_path.rglob("*.txt"))


def test_data_older_than_what_is_kept_do_not_replace_it(
    tmp_path: Path, client: httpx.Client, provider: Provider
) -> None:
    provider.tell("/first", b"1", b"5")
    newer = take(source(provider), tmp_path, NOW, client)
    again = take(source(provider), tmp_path, NOW, client)
    assert again.path == newer.path and "older than what is kept" in again.problems[0]


def test_data_of_the_future_are_refused(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    provider.tell("/first", b"-2")
    provider.tell("/second", b"4")
    taken = take(source(provider), tmp_path, NOW, client)
    assert taken.provider == "second" and "of the future" in taken.problems[0]


def test_a_damaged_kept_file_is_left_out(tmp_path: Path, client: httpx.Client, provider: Provider) -> None:
    provider.tell("/first", b"9", b"2")
    older = take(source(provider), tmp_path, NOW, client)
    newer = take(source(provider), tmp_path, NOW, client)
    newer.path.write_bytes(b"0")
    assert [kept.path for kept in kept_files("hours", tmp_path)] == [older.path]
