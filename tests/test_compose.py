"""docker-compose.yml and Dockerfile against the code that they start: what can be known without a container engine."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from fastapi import FastAPI

from flows.commands.__main__ import main
from flows.demo import named_services
from flows.services import SERVICES
from shared.security.api_keys import KeyRing, read_keys
from shared.settings import ServiceSettings

REPOSITORY = Path(__file__).resolve().parents[1]
PORTS = {"access": 8001, "prioritization": 8002, "planning": 8003, "retrieval": 8004, "arrival": 8005}
COMPOSE: dict[str, Any] = yaml.safe_load((REPOSITORY / "docker-compose.yml").read_text())
DOCKERFILE = (REPOSITORY / "Dockerfile").read_text()


def part(name: str) -> dict[str, Any]:
    service: dict[str, Any] = COMPOSE["services"][name]
    return service


def option(name: str, flag: str) -> str:
    command: list[str] = part(name)["command"]
    return command[command.index(flag) + 1]


def test_there_are_the_five_services_and_a_test() -> None:
    assert set(COMPOSE["services"]) == {"keys", *SERVICES, "demo"}
    assert [name for name in COMPOSE["services"] if "profiles" not in part(name)] == ["keys", *PORTS]
    assert part("demo")["profiles"] == ["test"]


@pytest.mark.parametrize(("name", "port"), PORTS.items())
def test_a_service_listens_on_its_port_and_is_published_on_loopback_only(name: str, port: int) -> None:
    assert option(name, "--port") == str(port)
    assert part(name)["ports"] == [f"127.0.0.1:{port}:{port}"]


@pytest.mark.parametrize(("name", "port"), PORTS.items())
def test_a_command_starts_an_application_that_answers_its_health_check(name: str, port: int) -> None:
    server, target = part(name)["command"][:2]
    assert server == "uvicorn"
    module, _, attribute = target.partition(":")
    assert module == f"services.{name}.app"
    app = getattr(importlib.import_module(module), attribute)
    assert isinstance(app, FastAPI)
    kind, program, flag, code = part(name)["healthcheck"]["test"]
    assert (kind, program, flag) == ("CMD", "python", "-c")
    compile(code, "healthcheck", "exec")
    checked = re.search(r"http://127\.0\.0\.1:(\d+)(/\w+)", code)
    assert checked is not None
    assert checked.groups() == (str(port), "/readyz")
    assert app.url_path_for("readyz") == checked[2]


@pytest.mark.parametrize("name", ["keys", *PORTS, "demo"])
def test_a_container_is_not_root_and_writes_only_to_the_volume_and_memory(name: str) -> None:
    service = part(name)
    assert service["user"] == "10001:10001"
    assert service["read_only"] is True
    assert service["volumes"] == ["artifacts:/data", "keys:/keys"]
    assert service["tmpfs"] == ["/tmp"]
    assert service["cap_drop"] == ["ALL"]
    assert "privileged" not in service


@pytest.mark.parametrize("name", PORTS)
def test_its_environment_is_made_of_settings_that_exist(name: str) -> None:
    environment = part(name)["environment"]
    prefix = f"SMOKEGLINT_{name.upper()}_"
    known = {
        start + field.upper() for field in ServiceSettings.model_fields for start in (prefix, "SMOKEGLINT_SERVICE_")
    }
    assert set(environment) <= known
    assert environment[prefix + "ARTIFACT_ROOT"] == "/data"
    assert part(name)["restart"] == "unless-stopped"


def test_services_know_the_keys_that_are_made_before_they_start(tmp_path: Path) -> None:
    command = part("keys")["command"]
    assert command[:-1] == ["python", "-m", "flows.commands", "key", "prepare"] and command[-1] == "/keys"
    for _ in range(2):  # a second start makes no others
        assert main([*command[3:-1], str(tmp_path)]) == 0
    ring = KeyRing(tmp_path / Path(part("access")["environment"]["SMOKEGLINT_SERVICE_API_KEYS"]).name)
    flow = ring.holder(
        (tmp_path / Path(part("demo")["environment"]["SMOKEGLINT_API_KEY_FILE"]).name).read_text().strip()
    )
    assert flow is not None and flow.may("execute") and not flow.may("admin")
    assert len(read_keys(tmp_path / "keys.json")) == 2
    for name in PORTS:
        assert part(name)["depends_on"] == {"keys": {"condition": "service_completed_successfully"}}


def test_the_test_reaches_the_services_over_the_same_root_once_they_are_healthy() -> None:
    urls = named_services(part("demo")["environment"]["SMOKEGLINT_SERVICES"])
    assert urls == {name: f"http://{name}:{port}" for name, port in PORTS.items()}
    assert option("demo", "--root") == "/data"
    assert importlib.util.find_spec(option("demo", "-m")) is not None
    assert part("demo")["depends_on"] == {key: {"condition": "service_healthy"} for key in PORTS}


def test_the_image_is_pinned_ends_as_another_user_than_root_and_gets_every_folder_it_copies() -> None:
    base = re.search(r"^ARG BASE=(\S+)$", DOCKERFILE, re.MULTILINE)
    assert base is not None
    assert re.fullmatch(r"python:3\.11\.\d+-slim-\w+(@sha256:[0-9a-f]{64})?", base[1])
    assert {part(name)["build"]["args"]["BASE"] for name in COMPOSE["services"]} == {f"${{BASE-{base[1]}}}"}
    final = DOCKERFILE.split("\nFROM ")[-1]
    assert re.findall(r"^USER (\S+)$", final, re.MULTILINE) == ["10001:10001"]
    copied = re.findall(r"^COPY (?!--from)(\S+) ", DOCKERFILE, re.MULTILINE)
    admitted = [line[1:] for line in (REPOSITORY / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert sorted(copied) == sorted(admitted) == ["flows", "requirements.lock", "services", "shared"]
    assert all((REPOSITORY / name).exists() for name in copied)
