"""A provider to ask, a client to ask it with, and no waiting between tries."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest

from flows.ingest import fetching
from tests.flows.ingest.provider import Provider, running_provider


@pytest.fixture
def provider() -> Iterator[Provider]:
    with running_provider() as running:
        yield running


@pytest.fixture
def client() -> Iterator[httpx.Client]:
    with httpx.Client() as opened:
        yield opened


@pytest.fixture(autouse=True)
def naps(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pauses that would have been made."""
    made: list[float] = []
    monkeypatch.setattr(fetching, "_sleep", made.append)
    monkeypatch.setattr(fetching, "_BACKOFF", lambda state: 0.1 * state.attempt_number)
    return made
