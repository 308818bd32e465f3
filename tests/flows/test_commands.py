"""The shell command: what it says of finished steps, what it forgets on request, and how it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from flows.commands.__main__ import main
from flows.redo import CYCLE_STEPS, forget_from
from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import Manifest, Product
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore, describe_file
from shared.errors import DomainError
from shared.security.api_keys import KeyRing

CASE, FIRST, SECOND = "simulated-tiny", "20250901T1200Z", "20250902T1200Z"


def finish(root: Path, cycle: str, step: str, oldest: str = "") -> None:
    store = ArtifactStore(Roots(str(root)))
    address = StepAddress(CASE, cycle, step, "k1")
    with store.staging("flow", step) as staging:
        files = {"map.png": staging / "map.png", "report.json": staging / "report.json"}
        for path in files.values():
            path.write_bytes(step.encode())
        product = Product(process=step, code_version="v", simulated=True, simulated_share=0.5, oldest_input=oldest)
        entries = {name: describe_file(path) for name, path in files.items()}
        parts = {"product": product, "inputs": (), "parameters": {}, "outputs": {}, "files": entries}
        store.commit(address, files, Manifest(case=CASE, cycle=cycle, key="k1", **parts))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A first cycle that is done, a second that stands before its plan, and a comparison, which is no cycle."""
    for step in CYCLE_STEPS:
        finish(tmp_path, FIRST, step, "2025-08-31T00:00:00Z")
    for step in CYCLE_STEPS[: CYCLE_STEPS.index("plan-observations")]:
        finish(tmp_path, SECOND, step)
    finish(tmp_path, f"{SECOND}-no-feedback", "score")
    return tmp_path


def test_status_says_where_each_cycle_stands(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--case", "tiny", "--root", str(root), "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)
    assert (first["cycle"], first["done"], first["next"]) == (FIRST, len(CYCLE_STEPS) - 1, "")
    assert (second["cycle"], second["next"]) == (SECOND, "plan-observations")
    assert (first["oldest_input"], first["simulated_share"]) == ("2025-08-31T00:00:00Z", 0.5)


def test_products_are_listed_with_their_mark(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chosen = ["--cycle", FIRST, "--kind", "png"]
    assert main(["products", "--case", CASE, "--root", str(root), *chosen]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(CYCLE_STEPS) and all("SIMULATED" in line and line.endswith("map.png") for line in lines)
    assert all((root / line.split()[-1]).is_file() for line in lines)


def test_forgetting_a_step_forgets_those_after_it_and_nothing_else(root: Path) -> None:
    assert forget_from(root, "tiny", "execute", cycle=1) == len(CYCLE_STEPS) - CYCLE_STEPS.index("execute")
    store = ArtifactStore(Roots(str(root)))
    done = {manifest.product.process for manifest in store.manifests(CASE) if manifest.cycle == FIRST}
    assert done == set(CYCLE_STEPS[: CYCLE_STEPS.index("execute")])
    assert (root / CASE / FIRST / "execute" / "k1" / "map.png").exists(), "files stay until the step is made anew"


@pytest.mark.parametrize(
    ("step", "cycle", "match"), [("bake", 0, "no step 'bake'"), ("score", 9, "no finished cycle 9")]
)
def test_what_cannot_be_forgotten_is_named(root: Path, step: str, cycle: int, match: str) -> None:
    with pytest.raises(DomainError, match=match):
        forget_from(root, "tiny", step, cycle)


def test_a_key_made_here_opens_a_service(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "keys.json"
    assert main(["key", "add", "ops", "--file", str(file), "--scope", "execute", "--days", "30"]) == 0
    key = capsys.readouterr().out.strip()
    holder = KeyRing(file).holder(key)
    assert holder is not None and holder.name == "ops" and holder.may("execute")
    assert main(["key", "add", "flow", "--file", str(file), "--save-to", str(tmp_path / "flow.key")]) == 0
    assert capsys.readouterr().out == "" and KeyRing(file).holder((tmp_path / "flow.key").read_text().strip())
    assert main(["key", "list", "--file", str(file)]) == 0
    assert key not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["status", "--case", "none"], 1, "Nothing of case 'none' is finished"),
        (["run", "--case", "tiny", "--cycle-hours", "7"], 1, "6, 12 or 24"),
        (["run", "--case", "tiny", "--without", "hope"], 1, "no feedback 'hope'"),
        (["key", "add", "x", "--file", "f", "--scope", "root"], 1, "no scope 'root'"),
        (["key", "remove", "x", "--file", "f"], 1, "cannot be read"),
        (["bake"], 2, "No such command"),
        (["run"], 2, "--case"),
    ],
)
def test_a_wrong_command_is_told_in_a_line(
    arguments: list[str],
    status: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == status
    told = capsys.readouterr()
    assert said in told.out + told.err
    assert "Traceback" not in told.err
