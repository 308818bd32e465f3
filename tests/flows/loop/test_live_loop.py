"""The loop on a live bundle: what was fetched becomes a plan, and the cycle then waits for its end."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from flows.case_store import inputs_of_cycle
from flows.cases.live.bundles import add_bundle, begin, read_live
from flows.desk.approval import CycleUnderWay
from flows.ingest import sources
from flows.loop import run_cycle
from flows.loop_types import BUNDLE, FEEDBACKS, CaseInputs, Handover, cycle_label
from flows.profiles import profile_of
from flows.runner import DirectRunner, open_store
from tests.flows.ingest.playing import AREA, NOW, play_all
from tests.flows.ingest.provider import running_provider

pytestmark = [pytest.mark.loop, pytest.mark.xdist_group("loop")]


def test_a_plan_is_made_of_what_the_providers_gave(
    services: tuple[Path, dict[str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, urls = services
    with running_provider() as provider:
        play_all(provider, monkeypatch)
        assert not sources.fetch_all(AREA, tmp_path, NOW).failed
    begin(root, AREA, tmp_path, NOW)
    add_bundle(root, NOW)
    case, profile = read_live(root), profile_of("live")
    store, label = open_store(root, case.folder), cycle_label(NOW)
    bundle = DirectRunner(urls, store, "test-live", lambda _: None, case.name, f"{BUNDLE}-{label}")
    nothing = CaseInputs(case.name, case.region, case.first_cutoff, {}, {})
    inputs = inputs_of_cycle(bundle, case, nothing, 1)
    runner = DirectRunner(urls, store, "test-live", lambda _: None, case.name, label)
    with pytest.raises(CycleUnderWay, match="until 2026-07-02 12:10 UTC"):
        run_cycle(runner, inputs, NOW, Handover(), frozenset(FEEDBACKS), profile.settings, now=NOW)
    made = {
        json.loads(path.read_text())["product"]["process"]: path
        for path in (root / "live" / label).rglob("manifest.json")
    }
    told = {name: json.loads(path.read_text())["product"] for name, path in made.items()}
    assert {"rate-active-fires", "build-targets", "plan-observations", "check-plan", "uplink"} <= set(told)
    # The elements and the weather are real, the fuels are not: the ratings say half.
    assert not told["predict-access"]["simulated"] or told["predict-access"]["simulated_share"] < 0.5
    assert told["rate-active-fires"]["simulated"] and 0 < told["rate-active-fires"]["simulated_share"] < 1
    targets = json.loads(next(made["build-targets"].parent.glob("report.json")).read_text())
    assert targets["active_targets"] > 0 and {fire["incident_id"] for fire in targets["fires"]} == {
        "2026-AZ-1",
        "2026-AZ-4",
    }
