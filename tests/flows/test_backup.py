"""A backup comes back as it was, verified; what is no backup, or would leave the root, comes back not at all."""

from __future__ import annotations

import io
import sqlite3
import tarfile
from pathlib import Path

import pytest

from flows.backup import back_up, restore
from flows.commands.__main__ import main
from flows.desk.decisions import Decision, DecisionLog
from shared.artifacts.address import StepAddress
from shared.artifacts.manifest import Manifest, Product
from shared.artifacts.roots import Roots
from shared.artifacts.store import ArtifactStore, describe_file
from shared.errors import DomainError
from shared.process.jobs import JobRegister, JobRequest

ADDRESS = StepAddress("case", "20250901T1200Z", "build-targets", "k1")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A root with a finished step, a job, a decision, and what a run leaves lying about."""
    folder = tmp_path / "artifacts"
    store = ArtifactStore(Roots(str(folder)))
    with store.staging("flow", "job") as staging:
        path = staging / "targets.json"
        path.write_bytes(b"{}")
        product = Product(process="build-targets", code_version="v")
        parts = {"product": product, "inputs": (), "parameters": {}, "outputs": {}}
        files = {"targets.json": describe_file(path)}
        named = {"case": ADDRESS.case, "cycle": ADDRESS.cycle, "key": ADDRESS.key}
        store.commit(ADDRESS, {"targets.json": path}, Manifest(**named, **parts, files=files))
    decided = {"who": "ann", "why": "x", "action": "pin", "cycle": ADDRESS.cycle, "target_id": 1}
    DecisionLog(folder, "case").append(Decision(**decided))
    (folder / ".jobs").mkdir()
    register = JobRegister(f"sqlite:///{folder / '.jobs' / 'planning.sqlite'}")
    register.submit(JobRequest("plan-observations", {}, "h", None, "c", "ops"))
    register.close()
    for name in (".lock", ".staging/flow/x/half.tmp", ".logs/planning.log"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")
    return folder


def test_everything_worth_keeping_comes_back(root: Path, tmp_path: Path) -> None:
    archive, again = tmp_path / "backup.tar.gz", tmp_path / "again"
    kept = back_up(root, archive)
    restored = restore(archive, again)
    assert (restored.files, restored.verified, restored.damaged) == (kept, 1, ())
    assert ArtifactStore(Roots(str(again))).load(ADDRESS) is not None
    assert [item.target_id for item in DecisionLog(again, "case").all()] == [1]
    register = JobRegister(f"sqlite:///{again / '.jobs' / 'planning.sqlite'}")
    assert [job.process for job in register.all()] == ["plan-observations"]
    register.close()
    assert not any((again / name).exists() for name in (".lock", ".staging", ".logs"))


def test_a_database_is_whole_while_somebody_writes(root: Path, tmp_path: Path) -> None:
    database = root / ".jobs" / "planning.sqlite"
    with sqlite3.connect(database) as writing:
        writing.execute("UPDATE jobs SET status = 'running'")  # not committed yet
        back_up(root, tmp_path / "backup.tar.gz")
    restore(tmp_path / "backup.tar.gz", tmp_path / "again")
    with sqlite3.connect(tmp_path / "again" / ".jobs" / "planning.sqlite") as reading:
        assert reading.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert reading.execute("SELECT status FROM jobs").fetchall() == [("accepted",)]


def test_a_damaged_step_is_named(root: Path, tmp_path: Path) -> None:
    (root / ADDRESS.path / "targets.json").write_bytes(b"[]")
    back_up(root, tmp_path / "backup.tar.gz")
    assert restore(tmp_path / "backup.tar.gz", tmp_path / "again").damaged == (ADDRESS.path,)


def archive_of(path: Path, member: tarfile.TarInfo, content: bytes = b"") -> Path:
    with tarfile.open(path, "w:gz") as tar:
        member.size = len(content)
        tar.addfile(member, io.BytesIO(content))
    return path


def test_what_would_leave_the_root_is_refused(tmp_path: Path) -> None:
    outside = archive_of(tmp_path / "a.tar.gz", tarfile.TarInfo("../outside.txt"), b"x")
    link = tarfile.TarInfo("link")
    link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
    for archive in (outside, archive_of(tmp_path / "b.tar.gz", link)):
        with pytest.raises(DomainError):
            restore(archive, tmp_path / "again")
        assert not (tmp_path / "again").exists() and not (tmp_path / "outside.txt").exists()


def test_what_is_no_backup_is_refused(root: Path, tmp_path: Path) -> None:
    archive = tmp_path / "backup.tar.gz"
    back_up(root, archive)
    archive.write_bytes(archive.read_bytes()[:-200])
    with pytest.raises(DomainError, match="no whole backup"):
        restore(archive, tmp_path / "again")
    (tmp_path / "web.tar.gz").write_text("<html>")
    with pytest.raises(DomainError, match="no whole backup"):
        restore(tmp_path / "web.tar.gz", tmp_path / "again")
    with pytest.raises(DomainError, match="not empty"):
        restore(archive, root)
    with pytest.raises(DomainError, match="outside the artifact root"):
        back_up(root, root / "backup.tar.gz")
    assert not (tmp_path / "again").exists()


def test_the_commands_do_it(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    archive = str(tmp_path / "b.tar.gz")
    assert main(["backup", "--root", str(root), "--to", archive]) == 0
    assert main(["restore", "--from", archive, "--root", str(tmp_path / "again")]) == 0
    assert "1 steps verified, 0 damaged" in capsys.readouterr().out
