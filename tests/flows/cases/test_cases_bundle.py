"""case.toml: what is read is what was written, and a broken one says where."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path

import pytest

from flows.cases.bundle import Case, read_case
from shared.errors import ContractError, DomainError, MissingArtifactError


@pytest.fixture
def copy(tiny: Case, tmp_path: Path) -> Path:
    folder = tmp_path / "case"
    shutil.copytree(tiny.folder, folder)
    return folder


def _edit(folder: Path, old: str, new: str) -> None:
    text = (folder / "case.toml").read_text()
    assert old in text
    (folder / "case.toml").write_text(text.replace(old, new))


def test_reads_back_what_was_written(tiny: Case) -> None:
    case = read_case(tiny.folder)
    assert case == tiny
    assert case.name == "simulated-tiny"
    assert case.first_cutoff == datetime(2025, 9, 1, 12, tzinfo=UTC)
    assert case.cutoff(2) == datetime(2025, 9, 2, 12, tzinfo=UTC)
    assert case.cutoff(3, cycle_hours=6) == datetime(2025, 9, 2, tzinfo=UTC)


def test_an_unknown_name_lists_the_known_ones(tiny: Case) -> None:
    with pytest.raises(MissingArtifactError) as caught:
        tiny.path("perimeter")
    assert "detections" in caught.value.accepted


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("cycles = 2", "cycles = 0", "case.cycles"),
        ("cycles = 2", "cycles = true", "case.cycles"),
        ("region = [-110.4", "region = [110.4", "case.region"),
        ('first_cutoff = "2025-09-01T12:00:00Z"', 'first_cutoff = "2025-09-01T12:00:00"', "case.first_cutoff"),
        ("simulated = true\nregion", 'simulated = "yes"\nregion', "case.simulated"),
        ('fuels = "fuels.nc"', 'fuel = "fuels.nc"', "fuels"),
        ('fuels = "fuels.nc"', 'fuels = "../fuels.nc"', "inputs.fuels"),
        ('fuels = "fuels.nc"', 'fuels = "gone.nc"', "inputs.fuels"),
        ("[provenance.smap]", "[provenance.smop]", "provenance.smap"),
        ("[nature]", "[secrets]", "nature"),
        ("[case]", "[case", "case.toml"),
    ],
)
def test_a_broken_case_names_the_entry(copy: Path, old: str, new: str, field: str) -> None:
    _edit(copy, old, new)
    with pytest.raises(DomainError) as caught:
        read_case(copy)
    assert caught.value.field == field
    assert isinstance(caught.value, ContractError | MissingArtifactError)


def test_a_folder_without_a_case(tmp_path: Path) -> None:
    with pytest.raises(MissingArtifactError, match=r"case\.toml"):
        read_case(tmp_path)
