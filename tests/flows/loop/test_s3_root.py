"""The loop on an S3 server, in one process: the same products under the same keys as on disk, and a desk there."""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from typing import TYPE_CHECKING

import fsspec
import pystac
import pytest
from fastapi.testclient import TestClient

from flows.commands.__main__ import main
from flows.desk.app import create_desk
from flows.loop_types import BUNDLE
from flows.root import WORK, store_of, work_folder
from flows.root_lock import LOCK
from shared.settings import ServiceSettings
from tests.shared.servers import S3_ENVIRONMENT, s3_server

if TYPE_CHECKING:
    from conftest import TinyLoop

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]

# What takes long is laid into the store as if an earlier run had made it; the rest of the cycle is made there.
SEEDED = ("calibration", "predict-access", "plan-observations", "infer-fire-arrival")
MADE = {
    "build-targets",
    "rate-prefire-danger",
    "check-plan",
    "execute",
    "simulate-observations",
    "retrieve-burned-area",
}


@pytest.fixture(scope="module")
def s3_root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """An empty root on an S3 server of its own."""
    with pytest.MonkeyPatch.context() as patch, s3_server() as url:
        for name, value in (S3_ENVIRONMENT | {"AWS_ENDPOINT_URL": url}).items():
            patch.setenv(name, value)
        patch.setenv(WORK, str(tmp_path_factory.mktemp("work")))
        fsspec.get_filesystem_class("s3").clear_instance_cache()  # of other tests, with another server
        bucket = f"bucket-{uuid.uuid4().hex}"
        fsspec.filesystem("s3").mkdir(bucket)
        yield f"s3://{bucket}/artifacts"
    fsspec.get_filesystem_class("s3").clear_instance_cache()


def test_a_cycle_on_s3_is_the_same_to_the_byte(
    tiny: TinyLoop, s3_root: str, capsys: pytest.CaptureFixture[str]
) -> None:
    case = tiny.case.name
    remote = fsspec.filesystem("s3")
    folders = [path.parent for path in tiny.root.glob(f"{case}/*/*/*/manifest.json")]
    for folder in folders:
        relative = folder.relative_to(tiny.root)
        if set(relative.parts) & set(SEEDED) and tiny.cycles[1].label not in relative.parts:
            remote.put([str(path) for path in folder.iterdir()], f"{s3_root}/{relative.as_posix()}/")
    assert main(["run", "--case", "tiny", "--root", s3_root, "--ephemeral", "--cycle", "1"]) == 0, (
        capsys.readouterr().out
    )
    assert f"{s3_root}/{case}/catalogue/catalog.json" in capsys.readouterr().out.replace("\n", "")

    ours, theirs = store_of(s3_root), tiny.store
    both = (tiny.cycles[0].label, BUNDLE)
    expected = {address for address in theirs.addresses(case) if address.cycle in both}
    assert expected and expected <= set(ours.addresses(case))
    assert {address.step for address in expected} >= MADE
    for address in expected:
        assert ours.load(address) == theirs.load(address), address
    assert not remote.exists(f"{s3_root}/{LOCK}") and not remote.exists(f"{s3_root}/.staging")
    local = {path.name for path in work_folder(s3_root).iterdir()}
    assert not local & {".jobs", ".logs", ".prefect"}, "no database, no service, no server"


def test_its_catalogue_and_its_desk_are_read_from_there(tiny: TinyLoop, s3_root: str) -> None:
    case, label = tiny.case.name, tiny.cycles[0].label
    text = fsspec.filesystem("s3").cat_file(f"{s3_root}/{case}/catalogue/catalog.json")
    assert pystac.Catalog.from_dict(json.loads(text)).id == case
    with TestClient(create_desk(ServiceSettings(artifact_root=s3_root)), raise_server_exceptions=False) as desk:
        page = desk.get(f"/cases/tiny/cycles/{label}").text
        assert "situation.png" in page and "SIMULATED" in page
        named = ("situation", label)
        (picture,) = (m for m in store_of(s3_root).manifests(case) if (m.product.process, m.cycle) == named)
        found = desk.get(f"/files/{case}/{label}/situation/{picture.key}/situation.png")
        assert found.content.startswith(b"\x89PNG") and len(found.content) == picture.files["situation.png"].size
        assert desk.get(f"/files/{case}/nothing.png").status_code == 404
        body = {"action": "exclude", "cycle": label, "why": "smoke", "who": "ann", "target_id": 7}
        assert desk.post(f"/cases/{case}/decisions", json=body).status_code == 201
        assert [d["target_id"] for d in desk.get(f"/cases/{case}/decisions").json()] == [7]


def test_forgetting_and_status_work_there(tiny: TinyLoop, s3_root: str, capsys: pytest.CaptureFixture[str]) -> None:
    from flows.redo import forget_from

    assert main(["status", "--case", "tiny", "--root", s3_root, "--json"]) == 0
    assert [row["next"] for row in json.loads(capsys.readouterr().out)] == [""]
    assert forget_from(s3_root, "tiny", "situation") == 2
    assert main(["status", "--case", "tiny", "--root", s3_root, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["next"] == "situation"
