"""docker-compose.yml and Dockerfile against the code that they start: what can be known without a container engine."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path
from typing import Any

import botocore.session
import pytest
import yaml
from fastapi import FastAPI

from flows.commands.__main__ import main
from flows.demo import named_services
from flows.root import WORK
from flows.services import SERVICES
from shared.security.api_keys import KeyRing, read_keys
from shared.settings import ServiceSettings

REPOSITORY = Path(__file__).resolve().parents[1]
PORTS = {"access": 8001, "prioritization": 8002, "planning": 8003, "retrieval": 8004, "arrival": 8005}
ROOT, STORES = "s3://smokeglint/artifacts", ("postgres", "s3")
COMPOSE: dict[str, Any] = yaml.safe_load((REPOSITORY / "docker-compose.yml").read_text())
OURS = [name for name in COMPOSE["services"] if name not in STORES]
DOCKERFILE = (REPOSITORY / "Dockerfile").read_text()


def part(name: str) -> dict[str, Any]:
    service: dict[str, Any] = COMPOSE["services"][name]
    return service


def option(name: str, flag: str) -> str:
    command: list[str] = part(name)["command"]
    return command[command.index(flag) + 1]


def test_there_are_the_stores_the_services_what_drives_them_and_a_test() -> None:
    assert set(COMPOSE["services"]) == {*STORES, "keys", "prefect", *SERVICES, "flow", "desk", "demo"}
    assert {name for name in COMPOSE["services"] if "profiles" in part(name)} == {"demo"}
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


@pytest.mark.parametrize("name", OURS)
def test_a_container_is_not_root_and_writes_only_to_volumes_and_memory(name: str) -> None:
    service = part(name)
    assert service["user"] == "10001:10001"
    assert service["read_only"] is True
    assert service["volumes"] == ["keys:/keys", "stores:/stores", "work:/work"]
    assert {volume.partition(":")[0] for volume in service["volumes"]} <= set(COMPOSE["volumes"])
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
    own = {key for key in environment if key.startswith("SMOKEGLINT_")}
    assert own <= known | {WORK, "SMOKEGLINT_ROOT"}
    assert environment["SMOKEGLINT_SERVICE_ARTIFACT_ROOT"] == ROOT == environment["SMOKEGLINT_ROOT"]
    assert environment["SMOKEGLINT_SERVICE_JOB_DATABASE"] == "postgresql+psycopg://smokeglint@postgres/smokeglint"
    assert part(name)["restart"] == "unless-stopped"


def test_services_know_the_keys_that_are_made_before_they_start(tmp_path: Path) -> None:
    command = part("keys")["command"]
    assert command == ["python", "-m", "flows.commands", "key", "prepare", "/keys", "--stores", "/stores"]
    for _ in range(2):  # a second start makes no others
        assert main(["key", "prepare", str(tmp_path / "keys"), "--stores", str(tmp_path / "stores")]) == 0
        made = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert {path: path.read_bytes() for path in made} == made
    ring = KeyRing(inside(tmp_path, part("access")["environment"]["SMOKEGLINT_SERVICE_API_KEYS"]))
    key = inside(tmp_path, part("flow")["environment"]["SMOKEGLINT_API_KEY_FILE"]).read_text().strip()
    flow = ring.holder(key)
    assert flow is not None and flow.may("execute") and not flow.may("admin")
    assert len(read_keys(tmp_path / "keys" / "keys.json")) == 2


def inside(folder: Path, path: str) -> Path:
    return folder / path.removeprefix("/")


def test_clients_and_servers_of_the_stores_are_given_the_same_passwords(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["key", "prepare", str(tmp_path / "keys"), "--stores", str(tmp_path / "stores")]) == 0
    environment = part("access")["environment"]
    passes = inside(tmp_path, environment["PGPASSFILE"])
    password = inside(tmp_path, part("postgres")["environment"]["POSTGRES_PASSWORD_FILE"]).read_text()
    user = part("postgres")["environment"]["POSTGRES_USER"]
    assert passes.read_text() == f"*:*:*:{user}:{password}\n" and len(password) > 30
    assert passes.stat().st_mode & 0o077 == 0, "PostgreSQL's clients ignore one that others may read"
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_PROFILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(inside(tmp_path, environment["AWS_SHARED_CREDENTIALS_FILE"])))
    found = botocore.session.Session().get_credentials()
    script = part("s3")["command"][0]
    for name, value in (("AWS_ACCESS_KEY_ID", found.access_key), ("AWS_SECRET_ACCESS_KEY", found.secret_key)):
        path = re.search(rf"{name}=\$\$\(cat (\S+)\)", script)
        assert path is not None and inside(tmp_path, path[1]).read_text() == value
    assert f"S3_BUCKET={ROOT.split('/')[2]} " in script


@pytest.mark.parametrize("name", PORTS)
def test_a_service_starts_once_its_stores_are_healthy(name: str) -> None:
    done, healthy = {"condition": "service_completed_successfully"}, {"condition": "service_healthy"}
    assert part(name)["depends_on"] == {"keys": done, "postgres": healthy, "s3": healthy}
    assert part("postgres")["depends_on"] == part("s3")["depends_on"] == {"keys": done}
    assert all("healthcheck" in part(store) and "restart" in part(store) for store in STORES)


@pytest.mark.parametrize("name", ["flow", "demo"])
def test_what_drives_the_services_reaches_them_over_the_same_root_once_they_are_healthy(name: str) -> None:
    environment = part(name)["environment"]
    urls = named_services(environment["SMOKEGLINT_SERVICES"])
    assert urls == {service: f"http://{service}:{port}" for service, port in PORTS.items()}
    assert environment["SMOKEGLINT_ROOT"] == ROOT
    assert importlib.util.find_spec(option(name, "-m")) is not None
    waits_for = {*PORTS, "prefect"} if name == "flow" else set(PORTS)
    assert part(name)["depends_on"] == {key: {"condition": "service_healthy"} for key in waits_for}


def test_the_schedules_are_kept_by_prefect_on_postgresql() -> None:
    assert part("flow")["environment"]["PREFECT_API_URL"] == "http://prefect:4200/api"
    prefect = part("prefect")
    assert prefect["command"][:3] == ["prefect", "server", "start"] and option("prefect", "--port") == "4200"
    url = prefect["environment"]["PREFECT_API_DATABASE_CONNECTION_URL"]
    assert url == "postgresql+asyncpg://smokeglint@postgres/smokeglint"
    assert "ports" not in prefect, "nobody outside needs it"


def test_images_of_others_are_pinned_and_can_be_named_by_variable() -> None:
    for name in STORES:
        assert re.fullmatch(r"\$\{[A-Z0-9]+_IMAGE-[a-z/]+:[\w.-]*\d[\w.-]*\}", part(name)["image"])


def test_the_image_is_pinned_ends_as_another_user_than_root_and_gets_every_folder_it_copies() -> None:
    base = re.search(r"^ARG BASE=(\S+)$", DOCKERFILE, re.MULTILINE)
    assert base is not None
    assert re.fullmatch(r"python:3\.11\.\d+-slim-\w+(@sha256:[0-9a-f]{64})?", base[1])
    assert {part(name)["build"]["args"]["BASE"] for name in OURS} == {f"${{BASE-{base[1]}}}"}
    final = DOCKERFILE.split("\nFROM ")[-1]
    assert re.findall(r"^USER (\S+)$", final, re.MULTILINE) == ["10001:10001"]
    copied = re.findall(r"^COPY (?!--from)(\S+) ", DOCKERFILE, re.MULTILINE)
    admitted = [line[1:] for line in (REPOSITORY / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert sorted(copied) == sorted(admitted) == ["flows", "requirements.lock", "services", "shared"]
    assert all((REPOSITORY / name).exists() for name in copied)
