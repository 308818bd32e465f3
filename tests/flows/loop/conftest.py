"""The tiny case, run once through the five services as separate processes; every test of the loop looks at it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from flows.case_store import CALIBRATION, calibrate, import_into_store
from flows.cases.bundle import Case
from flows.demo import build_case
from flows.loop import run_cycle
from flows.loop_types import BUNDLE, FEEDBACKS, CaseInputs, CycleProducts, Handover, cycle_label
from flows.profiles import Profile, profile_of
from flows.runner import DirectRunner, open_store
from flows.services import running_services, wait_until_ready
from shared.artifacts.store import ArtifactStore

ALL = frozenset(FEEDBACKS)


@dataclass
class TinyLoop:
    """Two finished cycles of the tiny case, and the means to run parts of it again."""

    root: Path
    urls: dict[str, str]
    case: Case
    store: ArtifactStore
    profile: Profile
    inputs: CaseInputs
    cycles: list[CycleProducts]
    made: list[dict[str, Any]]

    def runner(self, part: str) -> DirectRunner:
        return DirectRunner(self.urls, self.store, f"test-{part}", lambda _: None, self.case.name, part, self.made)


@pytest.fixture(scope="session")
def services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """The five services over one artifact root."""
    root = tmp_path_factory.mktemp("loop") / "artifacts"
    root.mkdir()
    with running_services(root) as urls:
        wait_until_ready(urls)
        yield root, urls


@pytest.fixture(scope="session")
def tiny(services: tuple[Path, dict[str, str]]) -> TinyLoop:
    root, urls = services
    case = build_case("tiny", root)
    store, profile = open_store(root, case.folder), profile_of("tiny")
    loop = TinyLoop(root, urls, case, store, profile, CaseInputs("", case.region, case.first_cutoff, {}, {}), [], [])
    inputs = import_into_store(loop.runner(BUNDLE), case)
    days, step_s = profile.calibration_days, profile.calibration_step_s
    inputs = calibrate(loop.runner(CALIBRATION), inputs, days, step_s, profile.settings.seed)
    before = Handover()
    for number in (1, 2):
        cutoff = case.cutoff(number)
        cycle = run_cycle(loop.runner(cycle_label(cutoff)), inputs, cutoff, before, ALL, profile.settings)
        loop.cycles.append(cycle)
        before = cycle.handover
    return replace(loop, inputs=inputs)
