"""The desk over HTTP: pages that people can read, decisions that stay, and nothing that is nobody's business."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from fastapi.testclient import TestClient

from flows.desk.app import create_desk
from flows.desk.decisions import DecisionLog
from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import InputEntry, Manifest, Product
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore, describe_file
from shared.security.api_keys import add_key
from shared.settings import ServiceSettings

CASE, FIRST, SECOND = "simulated-tiny", "20250901T1200Z", "20250902T1200Z"
BIG_ID = 105000002750001295  # beyond 2^53


def finish(root: Path, cycle: str, step: str, files: dict[str, Any], inputs: tuple[InputEntry, ...] = ()) -> Manifest:
    store = ArtifactStore(Roots(str(root)))
    with store.staging("flow", step) as staging:
        paths = {}
        for name, content in files.items():
            paths[name] = staging / name
            if isinstance(content, pd.DataFrame):
                content.to_parquet(paths[name])
            else:
                paths[name].write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
        oldest = "2025-08-30T12:00:00Z"
        product = Product(process=step, code_version="v", simulated=True, simulated_share=1.0, oldest_input=oldest)
        entries = {name: describe_file(path) for name, path in paths.items()}
        named = {"case": CASE, "cycle": cycle, "key": "k1", "product": product, "inputs": inputs}
        address = StepAddress(CASE, cycle, step, "k1")
        return store.commit(address, paths, Manifest(**named, parameters={}, outputs={}, files=entries))


def targets(*ids: int) -> pd.DataFrame:
    kinds = {"kind": "active", "priority": 0.5, "source": "incident:F1"}
    return pd.DataFrame([{"target_id": target, **kinds} for target in ids])


def build(root: Path, cycle: str, ids: tuple[int, ...], observed: tuple[bool, ...]) -> Manifest:
    fire = {"incident_id": "F1", "name": "<b>Canyon</b> Fire", "reason": "driest of the week"}
    finish(root, cycle, "build-targets", {"targets.parquet": targets(*ids), "report.json": {"fires": [fire]}})
    kinds = {"active": {"planned": sum(observed), "total": len(ids)}}
    changes = {"kept": {"collect_s": 4, "downlink_s": 80}, "dropped_because": {"satellite lost": 3}}
    report = {"targets": kinds, "objective": 9.0, "bound": 10.0, "gap": 0.1, "images_planned": 3}
    report["previous_plan"] = {"changes": changes}
    outcomes = pd.DataFrame({"target_id": ids, "observed": observed})
    outcomes["reason"] = ["" if seen else "crowded out: storage" for seen in observed]
    files = {"schedule.parquet": outcomes, "target_outcomes.parquet": outcomes, "report.json": report}
    return finish(root, cycle, "plan-observations", files | {"gantt.png": b"\x89PNG", "wrfxweb_1.png": b"\x89PNG"})


def bring(root: Path, part: str, files: dict[str, tuple[str, bool, str]]) -> None:
    """The import of a bundle: each file with its oldest datum, whether it is simulated, and its source."""
    store = ArtifactStore(Roots(str(root)))
    with store.staging("flow", part) as staging:
        entries = {}
        for name, (oldest, simulated, source) in files.items():
            (staging / name).write_bytes(source.encode())
            told = {"simulated": simulated, "oldest_input": oldest, "source": source}
            entries[name] = describe_file(staging / name, **told)
        product = Product(process="import-case", code_version="v")
        named = {"case": CASE, "cycle": part, "key": "k1", "product": product, "inputs": ()}
        manifest = Manifest(**named, parameters={}, outputs={}, files=entries)
        store.commit(StepAddress(CASE, part, "import-case", "k1"), {n: staging / n for n in files}, manifest)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "artifacts"
    build(folder, FIRST, (BIG_ID, 2), (True, True))
    build(folder, SECOND, (BIG_ID, 3), (True, False))
    return folder


@pytest.fixture
def desk(root: Path) -> Iterator[TestClient]:
    with TestClient(create_desk(ServiceSettings(artifact_root=str(root))), raise_server_exceptions=False) as client:
        yield client


def test_a_cycle_stands_on_one_page(desk: TestClient) -> None:
    page = desk.get(f"/cases/tiny/cycles/{SECOND}").text
    for told in (
        "SIMULATED",
        "1 of 2",
        "1: crowded out: storage",
        "driest of the week",
        "active targets: 1 new, 1 gone, 0 re-weighted",
        "commands kept: 4 s recording, 80 s downlink",
        "dropped because satellite lost: 3 s",
        "9.0 of at most 10.0 (gap 10.00 %)",
        "2025-08-30 12:00 UTC",
        "72",
        "gantt.png",
    ):
        assert told in page, told
    assert page.count("<img") == 1, "a tile without axes is a file, not a picture"
    assert "wrfxweb_1.png" in page
    assert "<b>Canyon" not in page and "&lt;b&gt;Canyon" in page, "what people name things is text, not markup"
    assert "first cycle" in desk.get(f"/cases/tiny/cycles/{FIRST}").text
    front = desk.get("/").text
    assert front.index(SECOND) < front.index(FIRST) and "draft" in front


def test_each_input_says_where_it_came_from_and_a_late_one_stands_on_top(desk: TestClient, root: Path) -> None:
    stale = "NIFC WFIGS, data of 2025-08-31 06:00 UTC, 54.0 h old; STALE, older than 24 h"
    own = {"incidents.parquet": ("2025-08-31T06:00:00Z", False, stale)}
    own["fuels.nc"] = ("2025-08-01T00:00:00Z", True, "simulated, seed 1")
    bring(root, "bundle", {"incidents.parquet": ("2025-09-01T06:00:00Z", False, "NIFC WFIGS")})
    first = desk.get(f"/cases/tiny/cycles/{FIRST}").text
    assert "NIFC WFIGS" in first and "Late or missing" not in first
    bring(root, f"bundle-{SECOND}", own)
    page = desk.get(f"/cases/tiny/cycles/{SECOND}").text
    assert "Late or missing inputs: incidents." in page and f"<strong>{stale}</strong>" in page
    assert ">54<" in page and ">780<" in page, "hours before the cut-off"
    assert "NIFC WFIGS" in desk.get(f"/cases/tiny/cycles/{FIRST}").text, "a cycle without a bundle of its own"
    empty = {"detections.parquet": ("2025-09-02T12:00:00Z", False, "none: no fire points; the table is empty")}
    bring(root, f"bundle-{FIRST}", empty)
    assert "Late or missing inputs: detections." in desk.get(f"/cases/tiny/cycles/{FIRST}").text


def test_a_plan_is_approved_by_its_hash(desk: TestClient, root: Path) -> None:
    body = {"action": "approve", "cycle": SECOND, "why": "checked", "who": "ann"}
    assert desk.post("/cases/tiny/decisions", json=body).status_code == 201
    first, second = desk.get("/cases/tiny/plans").json()
    assert (first["state"], second["state"]) == ("draft", "approved")
    assert second["history"][-1]["who"] == "ann"
    (kept,) = DecisionLog(root, CASE).all()
    assert kept.schedule_sha256 == second["schedule_sha256"]


def test_what_became_of_a_plan_is_told(desk: TestClient, root: Path) -> None:
    digest = desk.get("/cases/tiny/plans").json()[0]["schedule_sha256"]
    of_plan = (InputEntry(name="schedule", href="x", sha256=digest),)
    sent = {"approved_by": "setting", "approved_at": "2025-09-01T13:00:00+00:00"}
    sent["satellites"] = [{"contact_start": None}, {"contact_start": "2025-09-01T13:08:00+00:00"}]
    finish(root, FIRST, "uplink", {"uplinks.json": sent}, of_plan)
    finish(root, FIRST, "execute", {"as_run.json": {}}, of_plan)
    history = desk.get("/cases/tiny/plans").json()[0]["history"]
    assert [step["state"] for step in history] == ["draft", "approved", "uplinked", "executed"]
    assert (history[1]["who"], history[2]["at"]) == ("setting", "2025-09-01T13:08:00+00:00")
    late = desk.post("/cases/tiny/decisions", json={"action": "reject", "cycle": FIRST, "why": "no", "who": "ann"})
    assert late.status_code == 422 and "executed already" in late.text
    assert desk.get("/cases/tiny/plans").json()[0]["history"] == history and not DecisionLog(root, CASE).all()


def test_targets_with_long_ids_are_pinned_exactly(desk: TestClient, root: Path) -> None:
    body = {"action": "pin", "cycle": SECOND, "why": "crew asks", "target_id": str(BIG_ID)}
    assert desk.post("/cases/tiny/decisions", json=body).status_code == 201
    assert DecisionLog(root, CASE).all()[0].target_id == BIG_ID
    assert f"pin {BIG_ID} (crew asks)" in desk.get(f"/cases/tiny/cycles/{SECOND}").text


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"action": "pin", "cycle": SECOND, "why": "x"}, "target_id"),
        ({"action": "pin", "cycle": "soon", "why": "x", "target_id": 1}, "cycle"),
        ({"action": "approve", "cycle": "20260101T0000Z", "why": "x"}, "cycle"),
        ({"action": "bake", "cycle": SECOND, "why": "x"}, "action"),
        ({"action": "pin", "cycle": SECOND, "why": "", "target_id": 1}, "why"),
    ],
)
def test_half_a_decision_is_refused_by_name(desk: TestClient, body: dict[str, Any], field: str) -> None:
    answer = desk.post("/cases/tiny/decisions", json=body)
    assert answer.status_code == 422 and field in answer.text


@pytest.mark.parametrize("path", [".jobs/access.sqlite", f"{CASE}/.decisions/x.json", "../secret.txt", "none.png"])
def test_what_is_no_product_is_not_served(desk: TestClient, root: Path, path: str) -> None:
    (root.parent / "secret.txt").write_text("secret")
    (root / ".jobs").mkdir(exist_ok=True)
    (root / ".jobs" / "access.sqlite").write_text("secret")
    assert desk.get(f"/files/{path.replace('..', '%2e%2e')}").status_code == 404


def test_products_are_served_with_their_type(desk: TestClient) -> None:
    picture = desk.get(f"/files/{CASE}/{FIRST}/plan-observations/k1/gantt.png")
    assert picture.status_code == 200 and picture.headers["content-type"] == "image/png"


@pytest.mark.parametrize("path", ["/cases/none/plans", "/cases/none/cycles/x", f"/cases/tiny/cycles/{FIRST}x"])
def test_what_is_not_there_is_not_found(desk: TestClient, path: str) -> None:
    assert desk.get(path).status_code == 404


def test_with_keys_the_name_is_that_of_the_key(root: Path, tmp_path: Path) -> None:
    keys = tmp_path / "keys.json"
    reader, duty = add_key(keys, "reader", ("read",)), add_key(keys, "duty-officer", ("execute",))
    settings = ServiceSettings(artifact_root=str(root), api_keys=str(keys))
    body = {"action": "exclude", "cycle": SECOND, "why": "smoke only", "target_id": 3, "who": "somebody else"}
    with TestClient(create_desk(settings)) as client:
        assert client.get("/").status_code == 401
        assert client.get("/", headers={"X-API-Key": reader}).status_code == 200
        assert client.post("/cases/tiny/decisions", json=body, headers={"X-API-Key": reader}).status_code == 403
        assert (
            client.post("/cases/tiny/decisions", json=body, headers={"X-API-Key": duty}).json()["who"] == "duty-officer"
        )
