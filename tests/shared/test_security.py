"""Who may ask for what: keys, tokens, scopes, and nobody from elsewhere while neither is set up."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from fastapi.testclient import TestClient

from shared.errors import DomainError
from shared.process.app import create_app
from shared.security.api_keys import KeyRing, add_key, read_keys, remove_keys
from shared.security.bearer import TokenVerifier, looks_like_token
from shared.security.principal import Principal, needed_scope
from shared.settings import ServiceSettings

ISSUER = "https://id.example.org"
REPOSITORY = Path(__file__).resolve().parents[2]
EXECUTE = "/processes/sleep/execution"


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    path = tmp_path_factory.mktemp("keys") / "keys.json"
    return SimpleNamespace(
        path=path,
        reader=add_key(path, "reader", ("read",)),
        ops=add_key(path, "ops", ("execute",)),
        science=add_key(path, "science", ("execute",)),
        admin=add_key(path, "admin", ("admin",)),
        late=add_key(path, "late", ("read",), datetime(2020, 1, 1, tzinfo=UTC)),
    )


@pytest.fixture(scope="module")
def guarded(root: Path, keys: SimpleNamespace) -> Iterator[TestClient]:
    """The toy service behind keys; two jobs at once for each."""
    from toy_processes import PROCESSES

    settings = ServiceSettings(artifact_root=str(root), api_keys=str(keys.path), max_jobs_per_key=2)
    app = create_app("toy", "Toy", PROCESSES, module="toy_processes", settings=settings)
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def test_scopes_hold_those_below_them() -> None:
    admin, reader = Principal("a", frozenset({"admin"})), Principal("r", frozenset({"read"}))
    assert admin.may("read") and admin.may("execute") and admin.may("admin")
    assert reader.may("read") and not reader.may("execute") and not reader.may("admin")
    assert (needed_scope("GET", "/jobs"), needed_scope("DELETE", "/jobs/1")) == ("read", "execute")
    assert needed_scope("GET", "/healthz") is None and needed_scope("GET", "/metrics") == "read"


def test_a_key_is_kept_as_its_hash_in_a_file_of_its_owner(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    key = add_key(path, "ops", ("read", "execute"))
    assert key not in path.read_text() and path.stat().st_mode & 0o077 == 0
    assert KeyRing(path).holder(key) == Principal("ops", frozenset({"read", "execute"}))
    assert KeyRing(path).holder(key + "x") is None


def test_a_key_is_rotated_without_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    old = add_key(path, "ops", ("read",))
    ring = KeyRing(path)
    new = add_key(path, "ops", ("read",))
    assert ring.holder(old) and ring.holder(new), "both hold until the old one is removed"
    assert remove_keys(path, "ops", keep_newest=True) == 1
    assert ring.holder(old) is None and ring.holder(new)


def test_a_broken_key_file_leaves_the_last_good_one_in_force(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    key = add_key(path, "ops", ("read",))
    ring = KeyRing(path)
    path.write_text("{")
    assert ring.holder(key)
    path.unlink()
    assert ring.holder(key)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("{", "Invalid JSON"),
        ('{"keys": [{"name": "a", "sha256": "plain", "scopes": ["read"]}]}', r"keys\.0\.sha256"),
        ('{"keys": [{"name": "a", "sha256": "' + 64 * "0" + '", "scopes": ["root"]}]}', r"keys\.0\.scopes"),
    ],
)
def test_a_bad_key_file_is_refused_at_the_start(tmp_path: Path, content: str, match: str) -> None:
    (tmp_path / "keys.json").write_text(content)
    with pytest.raises(DomainError, match=match):
        read_keys(tmp_path / "keys.json")
    with pytest.raises(DomainError, match="No such file"):
        KeyRing(tmp_path / "none.json")


def test_without_a_credential_only_the_probes_answer(guarded: TestClient) -> None:
    assert guarded.get("/healthz").status_code == 200
    for path in ("/", "/jobs", "/processes", "/metrics", "/api"):
        answer = guarded.get(path)
        assert answer.status_code == 401 and answer.headers["content-type"] == "application/problem+json"
        assert answer.headers["WWW-Authenticate"].startswith("Bearer") and answer.headers["X-Correlation-ID"]


def test_a_wrong_or_expired_key_is_nobody(guarded: TestClient, keys: SimpleNamespace) -> None:
    for key in ("sg_wrong", keys.late, "", "a.b.c"):
        assert guarded.get("/jobs", headers=bearer(key)).status_code == 401


def test_a_reader_reads_and_no_more(guarded: TestClient, keys: SimpleNamespace) -> None:
    assert guarded.get("/jobs", headers={"X-API-Key": keys.reader}).status_code == 200
    refused = guarded.post(EXECUTE, json={"inputs": {"seconds": 0}}, headers=bearer(keys.reader))
    assert refused.status_code == 403 and "needs 'execute'" in refused.json()["detail"]


def test_a_job_is_its_owners_to_dismiss_or_an_admins(guarded: TestClient, keys: SimpleNamespace) -> None:
    jobs = []
    for key in (keys.ops, keys.ops):
        asked = guarded.post(
            EXECUTE, json={"inputs": {"seconds": 30 + len(jobs)}}, headers=bearer(key) | {"Prefer": "respond-async"}
        )
        jobs.append(asked.json()["jobID"])
    third = guarded.post(EXECUTE, json={"inputs": {"seconds": 40}}, headers=bearer(keys.ops))
    assert third.status_code == 429 and int(third.headers["Retry-After"]) > 0
    assert "'ops' has 2 jobs" in third.json()["detail"]
    refused = guarded.delete(f"/jobs/{jobs[0]}", headers=bearer(keys.science))
    assert refused.status_code == 403 and "belongs to 'ops'" in refused.json()["detail"]
    for job, key in zip(jobs, (keys.ops, keys.admin), strict=True):
        assert guarded.delete(f"/jobs/{job}", headers=bearer(key)).json()["status"] == "dismissed"


@pytest.fixture(scope="module")
def signing() -> rsa.RSAPrivateKey:
    return rsa.generate_private_key(public_exponent=65537, key_size=2048)


def token(signing: Any, algorithm: str = "RS256", **changes: Any) -> str:
    now = datetime.now(UTC)
    claims = {"iss": ISSUER, "aud": "smokeglint", "sub": "ann", "exp": now + timedelta(minutes=5)}
    claims |= {"scope": "openid smokeglint:execute"} | changes
    return jwt.encode({k: v for k, v in claims.items() if v is not None}, signing, algorithm, headers={"kid": "k1"})


@pytest.fixture(scope="module")
def verifier(signing: rsa.RSAPrivateKey) -> TokenVerifier:
    class Keys:
        def get_signing_key_from_jwt(self, _: str) -> SimpleNamespace:
            return SimpleNamespace(key=signing.public_key())

    return TokenVerifier(ISSUER, "smokeglint", Keys())  # type: ignore[arg-type]


def test_a_token_of_the_issuer_names_its_holder(verifier: TokenVerifier, signing: rsa.RSAPrivateKey) -> None:
    valid = token(signing)
    assert looks_like_token(valid)
    assert verifier.holder(valid) == Principal("ann", frozenset({"execute"}))
    assert verifier.holder(token(signing, scope=["read"])) == Principal("ann", frozenset({"read"}))


@pytest.mark.parametrize(
    "changes",
    [
        {"iss": "https://elsewhere.example.org"},
        {"aud": "another"},
        {"exp": datetime(2020, 1, 1, tzinfo=UTC)},
        {"exp": None},
        {"sub": None},
        {"nbf": datetime.now(UTC) + timedelta(hours=1)},
    ],
)
def test_a_token_that_is_not_for_us_is_nobodys(
    verifier: TokenVerifier, signing: rsa.RSAPrivateKey, changes: dict[str, Any]
) -> None:
    assert verifier.holder(token(signing, **changes)) is None


def test_a_token_signed_otherwise_is_nobodys(verifier: TokenVerifier) -> None:
    stranger = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    assert verifier.holder(token(stranger)) is None
    assert verifier.holder(token("a shared secret of thirty-two bytes", "HS256")) is None
    assert verifier.holder(jwt.encode({"sub": "ann"}, None, algorithm="none")) is None


def test_the_issuers_keys_are_found_through_its_discovery_document(signing: rsa.RSAPrivateKey) -> None:
    import threading
    from http.server import BaseHTTPRequestHandler, HTTPServer

    public = json.loads(jwt.algorithms.RSAAlgorithm.to_jwk(signing.public_key())) | {"kid": "k1", "use": "sig"}

    class Issuer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            base = f"http://127.0.0.1:{self.server.server_address[1]}"
            known = {
                "/.well-known/openid-configuration": {"issuer": base, "jwks_uri": f"{base}/keys"},
                "/keys": {"keys": [public]},
            }
            body = json.dumps(known[self.path]).encode()
            self.send_response(200)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Issuer)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        url = f"http://127.0.0.1:{server.server_address[1]}"
        holder = TokenVerifier(url, "smokeglint").holder(token(signing, iss=url))
    finally:
        server.shutdown()
    assert holder == Principal("ann", frozenset({"execute"}))
    assert TokenVerifier(url, "smokeglint").holder(token(signing, iss=url)) is None, "the issuer is gone: nobody"


def start(tmp_path: Path, host: str, **environment: str) -> tuple[subprocess.Popen[bytes], int]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "uvicorn", "services.planning.app:app", "--host", host, "--port", str(port)]
    settings = {"SMOKEGLINT_PLANNING_ARTIFACT_ROOT": str(tmp_path), "PYTHONPATH": str(REPOSITORY)}
    process = subprocess.Popen(
        command,
        cwd=REPOSITORY,
        env=os.environ | settings | environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    return process, port


def reachable(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


def test_a_service_without_authentication_refuses_to_listen_beyond_loopback(tmp_path: Path) -> None:
    process, port = start(tmp_path, "0.0.0.0")
    _, errors = process.communicate(timeout=60)
    assert b"refusing to listen beyond loopback without authentication" in errors
    assert not reachable(port)


def test_with_keys_it_listens_anywhere(tmp_path: Path) -> None:
    add_key(tmp_path / "keys.json", "ops", ("read",))
    process, port = start(tmp_path, "0.0.0.0", SMOKEGLINT_SERVICE_API_KEYS=str(tmp_path / "keys.json"))
    try:
        deadline = time.monotonic() + 60
        while not reachable(port) and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)  # longer than the first looks of a service that would refuse
        assert process.poll() is None and reachable(port)
    finally:
        process.terminate()
        process.communicate(timeout=30)
