"""One tiny simulated case for all tests of this room."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.cases.bundle import Case
from flows.cases.simulated import build_simulated_case


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder: Path = tmp_path_factory.mktemp("tiny")
    return build_simulated_case("tiny", folder)
