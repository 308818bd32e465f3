"""Settings from the environment, a prefix a service; logs as JSON with an id that nobody can forge."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import structlog
from pydantic import ValidationError

from shared import telemetry
from shared.settings import ServiceSettings, service_settings


@pytest.fixture
def clean(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    for service in ("ACCESS", "PLANNING"):
        for name in ServiceSettings.model_fields:
            monkeypatch.delenv(f"SMOKEGLINT_{service}_{name.upper()}", raising=False)
    return monkeypatch


def test_each_service_has_its_prefix(clean: pytest.MonkeyPatch) -> None:
    clean.setenv("SMOKEGLINT_ACCESS_WORKERS", "3")
    clean.setenv("SMOKEGLINT_ACCESS_READ_ROOTS", '["/data/cases", "s3://bucket/cases"]')
    clean.setenv("SMOKEGLINT_PLANNING_ARTIFACT_ROOT", "s3://bucket/artifacts")
    clean.setenv("WORKERS", "9")
    access, planning = service_settings("access"), service_settings("planning")
    assert (access.workers, planning.workers) == (3, 1)
    assert (access.artifact_root, planning.artifact_root) == ("artifacts", "s3://bucket/artifacts")
    assert access.roots.read_roots == ("/data/cases", "s3://bucket/cases")
    assert (planning.roots.artifact_root, planning.roots.read_roots) == ("s3://bucket/artifacts", ())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("workers", "0"),
        ("workers", "65"),
        ("workers", "many"),
        ("max_body_bytes", "10"),
        ("log_level", "LOUD"),
        ("log_level", "INFO\n"),
        ("parent_pid", "-1"),
    ],
)
def test_a_bad_value_is_named(clean: pytest.MonkeyPatch, name: str, value: str) -> None:
    clean.setenv(f"SMOKEGLINT_ACCESS_{name.upper()}", value)
    with pytest.raises(ValidationError) as caught:
        service_settings("access")
    assert [item["loc"] for item in caught.value.errors()] == [(name,)]
    assert service_settings("planning").workers == 1, "the fault of one service is not another's"


def test_a_list_that_is_no_json_is_named(clean: pytest.MonkeyPatch) -> None:
    clean.setenv("SMOKEGLINT_ACCESS_READ_ROOTS", "/data/cases")
    with pytest.raises(Exception, match="read_roots"):
        service_settings("access")


def test_the_job_database_lies_beside_the_artifacts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    by_default = ServiceSettings(artifact_root=(tmp_path / "a b").as_uri())
    assert by_default.database_url("access") == f"sqlite:///{tmp_path}/a b/.jobs/access.sqlite"
    assert (tmp_path / "a b" / ".jobs").is_dir()
    assert ServiceSettings(job_database="postgresql://db/jobs").database_url("access") == "postgresql://db/jobs"
    monkeypatch.chdir(tmp_path)
    remote = ServiceSettings(artifact_root="s3://bucket/artifacts")
    assert remote.database_url("access") == f"sqlite:///{tmp_path}/.jobs/access.sqlite"


@pytest.fixture
def logs(capsys: pytest.CaptureFixture[str]) -> Iterator[Any]:
    """A function that gives the log lines written since the last call, decoded."""
    earlier = structlog.get_config()
    token = telemetry.correlation_id.set("")

    def read() -> list[dict[str, Any]]:
        out, err = capsys.readouterr()
        assert out == "", "logs belong on standard error"
        return [json.loads(line) for line in err.splitlines()]

    yield read
    telemetry.correlation_id.reset(token)
    structlog.configure(**earlier)


def test_a_log_line_is_json_with_its_context(logs: Any) -> None:
    telemetry.configure_logging("access")
    telemetry.logger().info("job ends", seconds=1.5, process="predict-access")
    telemetry.correlation_id.set("cycle-7")
    telemetry.logger().warning("slow")
    first, second = logs()
    assert (first["event"], first["level"], first["service"], first["seconds"]) == ("job ends", "info", "access", 1.5)
    assert first["timestamp"].endswith("Z")
    assert "correlation_id" not in first
    assert (second["event"], second["level"], second["correlation_id"]) == ("slow", "warning", "cycle-7")


def test_a_text_of_two_lines_is_one_line_of_log(logs: Any) -> None:
    telemetry.configure_logging("access")
    telemetry.logger().info('first\n{"event": "forged"}', path=Path("a\nb"))
    (line,) = logs()
    assert line["event"] == 'first\n{"event": "forged"}'


def test_a_fault_is_logged_with_its_trace(logs: Any) -> None:
    telemetry.configure_logging("access")
    try:
        raise RuntimeError("broken")
    except RuntimeError:
        telemetry.logger().exception("job fails")
    (line,) = logs()
    assert line["level"] == "error"
    assert "Traceback" in line["exception"]
    assert "RuntimeError: broken" in line["exception"]


def test_the_level_is_a_threshold(logs: Any) -> None:
    telemetry.configure_logging("access", "WARNING")
    telemetry.logger().info("chatter")
    telemetry.logger().error("fault")
    assert [line["event"] for line in logs()] == ["fault"]


@pytest.mark.parametrize("offered", ["cycle-7", "2024-07-01T00:00:00+00:00", "a" * 128])
def test_a_harmless_id_is_kept(offered: str) -> None:
    assert telemetry.accept_correlation_id(offered) == offered


@pytest.mark.parametrize(
    "offered", [None, "", "a b", "a\n", "a\nb", '", "level": "x', "a" * 129, "\x1b[31m", "größe", "{}", "a;b"]
)
def test_a_forged_id_is_replaced(offered: str | None) -> None:
    first, second = (telemetry.accept_correlation_id(offered) for _ in range(2))
    assert first != second
    assert first != offered
    assert len(first) == 32
    assert set(first) <= set("0123456789abcdef")
