"""Naming services that already run, instead of starting some."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.demo import main, named_services
from flows.services import SERVICES
from shared.errors import DomainError

ALL = ",".join(f"{name}=http://{name}:80{number:02}" for number, name in enumerate(SERVICES))


def test_five_pairs_name_five_services() -> None:
    assert named_services(ALL)["arrival"] == "http://arrival:8004"
    assert set(named_services(ALL.replace(",", ", "))) == set(SERVICES)


@pytest.mark.parametrize(
    "text",
    [
        "access=http://access:8001",
        ALL + ",access=http://other:8001",
        ALL.replace("arrival=", "departure="),
        ALL.replace("planning=http:", "planning=ftp:"),
        ALL.replace("=", ":"),
    ],
    ids=["one only", "one twice", "unknown name", "no http", "no pair"],
)
def test_anything_else_is_refused_with_what_is_accepted(text: str) -> None:
    with pytest.raises(DomainError) as refused:
        named_services(text)
    assert "arrival=http://host:port" in refused.value.accepted


def test_the_command_line_and_the_environment_are_both_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--case", "tiny", "--root", str(tmp_path), "--services", "by-option"]) == 1
    assert "'by-option' does not name the five services" in capsys.readouterr().out
    monkeypatch.setenv("SMOKEGLINT_SERVICES", "by-environment")
    assert main(["--case", "tiny", "--root", str(tmp_path)]) == 1
    assert "'by-environment' does not name the five services" in capsys.readouterr().out
