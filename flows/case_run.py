"""All cycles of a case, each carried out as one run, and what is made of them at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import partial
from typing import Any

import pandas as pd

from flows.case_store import CALIBRATION, calibrate, first_bundle, import_into_store, inputs_of_cycle
from flows.cases.bundle import Case
from flows.catalogue import write_catalogue
from flows.comparison import compare_cycles, read_reference
from flows.desk.approval import CyclePaused, Desk, NobodyDecides
from flows.loop import run_cycle
from flows.loop_types import BUNDLE, CaseInputs, CycleProducts, Handover, LoopSettings, cycle_label
from flows.profiles import Profile
from flows.published_day import PUBLISHED_ROWS, ROWS, map_priorities, plan_rows
from flows.root import ArtifactRoot
from flows.runner import Conductor, DirectRunner, Display, Runner
from flows.stages import KNOWN_INPUTS
from flows.steps import ASSEMBLE_INPUTS, SCORE, SCORE_PERIMETER, SITUATION
from shared.artifacts.roots import is_local, local_path
from shared.artifacts.store import ArtifactStore
from shared.contracts import tables
from shared.memory import give_back_freed_memory

PLAIN = "no-feedback"
PERIMETERS = "perimeters"


@dataclass(frozen=True)
class CaseResult:
    """What a person is shown of a finished case."""

    cycles: list[CycleProducts]
    changes: Mapping[str, Any]
    perimeters: list[Mapping[str, Any]]
    shown: list[str]
    stale_runs: int
    paused: CyclePaused | None = None
    planner_rows: Sequence[Mapping[str, Any]] = ()


@dataclass
class _CaseRun:
    """One case under way: where each named part runs, and everything made so far."""

    conductor: Conductor
    case: Case
    store: ArtifactStore
    urls: Mapping[str, str]
    display: Display
    profile: Profile
    desk: Desk
    now: datetime | None
    made: list[dict[str, Any]]

    def runner(self, part: str) -> DirectRunner:
        """A runner whose products lie under that part of the case; its name is also the correlation id."""
        name = f"{self.case.name}-{part}"
        return DirectRunner(self.urls, self.store, name, self.display, self.case.name, part, self.made)

    def carry_out(self, part: str, work: Callable[[Runner], Any]) -> Any:
        return self.conductor.run(f"{self.case.name}-{part}", self.runner(part), work)


def run_case(
    conductor: Conductor,
    case: Case,
    store: ArtifactStore,
    root: ArtifactRoot,
    urls: Mapping[str, str],
    display: Display,
    profile: Profile,
    feedback: frozenset[str],
    numbers: Sequence[int],
    *,
    again_plain: bool,
    desk: Desk,
    now: datetime | None = None,
) -> CaseResult:
    """Import, calibrate, run the cycles of these numbers, compare with no feedback, score, write the catalogue.

    The cycles end where one can go no further yet: its plan is not approved by the ``desk``, or it is not over ``now``
    (where that is given). The result says which.
    """
    stale = conductor.close_stale_runs()
    run = _CaseRun(conductor, case, store, urls, display, profile, desk, now, [])
    inputs, done, paused = _cycles(run, feedback, numbers)
    if not done:
        return CaseResult([], {}, [], [], stale, paused)
    compared = again_plain and paused is None and len(numbers) > 1
    changes = _change_by_feedback(run, inputs, numbers[-1], done) if compared else {}
    # Detections simulated over the perimeters would score themselves.
    seen = not case.provenance["detections"].simulated
    perimeters = _perimeter_scores(run, inputs) if seen and "perimeters" in inputs.inputs else []
    rows: Mapping[str, Any] = {}
    if PUBLISHED_ROWS in inputs.inputs:  # plans of their own: no step of the cycle, whose plan is the one on board
        rows = run.carry_out(ROWS, lambda runner: plan_rows(runner, inputs, done[-1]))
    times = _times(case, done[-1], [_cutoff(case, number, profile.settings) for number in numbers])
    catalogue = write_catalogue(store, root, case.name, case.title, case.region, times, run.made)
    shown = [*_pictures(done, perimeters, rows), catalogue]
    return CaseResult(done, changes, perimeters, shown, stale, paused, rows.get("rows", []))


def _cycles(
    run: _CaseRun, feedback: frozenset[str], numbers: Sequence[int]
) -> tuple[CaseInputs, list[CycleProducts], CyclePaused | None]:
    """The cycles of these numbers as far as they go: the last one's inputs, what is finished, and where it ended."""
    case, profile = run.case, run.profile
    calibration = (profile.calibration_days, profile.calibration_step_s, profile.settings.seed)
    imported = run.carry_out(BUNDLE, lambda runner: import_into_store(runner, first_bundle(case)))
    inputs = run.carry_out(CALIBRATION, lambda runner: calibrate(runner, imported, *calibration))
    done: list[CycleProducts] = []
    for number in numbers:
        label = cycle_label(_cutoff(case, number, profile.settings))
        if case.bundles:
            own = partial(inputs_of_cycle, case=case, first=inputs, number=number)
            inputs = run.carry_out(f"{BUNDLE}-{label}", own)
        last = _cycle(run, inputs, number, done[-1].handover if done else Handover(), feedback, label)
        if isinstance(last, CyclePaused):
            return inputs, done, last
        done.append(last)
    return inputs, done, None


def _change_by_feedback(
    run: _CaseRun, inputs: CaseInputs, number: int, done: Sequence[CycleProducts]
) -> Mapping[str, Any]:
    """The last cycle run again without feedback and without people's decisions, and what is different."""
    before = done[-2].handover if len(done) > 1 else Handover()
    without = replace(run, desk=NobodyDecides())
    plain = _cycle(without, inputs, number, before, frozenset(), f"{done[-1].label}-{PLAIN}")
    assert isinstance(plain, CycleProducts)
    return compare_cycles(run.store, done[-1].steps, plain.steps)


def _pictures(
    done: Sequence[CycleProducts], perimeters: Sequence[Mapping[str, Any]], rows: Mapping[str, Any]
) -> list[str]:
    """What a person looks at first: each cycle's situation, the last arrival maps, the maps of a published day."""
    last_maps = [perimeters[-1]["map"]] if perimeters else done[-1].steps["infer-fire-arrival"]["maps"]
    maps = [*(cycle.steps["situation"]["map"] for cycle in done), *last_maps]
    if rows:
        maps += [done[-1].steps["priority-map"]["map"], rows["table"]]
    return [_place(str(reference["href"])) for reference in maps]


def _place(href: str) -> str:
    """Where a person finds a file: its path on this machine, or its URL."""
    return str(local_path(href)) if is_local(href) else href


def _cutoff(case: Case, number: int, settings: LoopSettings) -> Any:
    return case.cutoff(number, settings.cycle_hours)


def _cycle(
    run: _CaseRun, inputs: CaseInputs, number: int, before: Handover, feedback: frozenset[str], part: str
) -> CycleProducts | CyclePaused:
    settings = run.profile.settings
    cutoff = _cutoff(run.case, number, settings)

    def whole(runner: Runner) -> CycleProducts | CyclePaused:
        try:
            products = run_cycle(runner, inputs, cutoff, before, feedback, settings, run.desk, run.now)
        except CyclePaused as paused:  # no failure: the run ends here, and another goes on
            return paused
        return replace(products, steps={**products.steps, **_publish(runner, run.case, inputs, products)})

    finished: CycleProducts | CyclePaused = run.carry_out(part, whole)
    give_back_freed_memory()
    return finished


def _publish(runner: Runner, case: Case, inputs: CaseInputs, cycle: CycleProducts) -> dict[str, Mapping[str, Any]]:
    """The map and the scores of a finished cycle; of a day with published planner rows also the map of priorities."""
    steps = cycle.steps
    # On a real case the surface that the simulator sees was itself made from the perimeters: no truth to score with.
    truth = inputs.nature.get("truth") if case.simulated else None
    arrival = steps["infer-fire-arrival"]["fire_arrival"]
    burned = steps["retrieve-burned-area"]["burned_area"]
    drawn = {
        "title": case.title,
        "region": list(case.region),
        "cutoff": cycle.cutoff.isoformat(),
        "end": cycle.end.isoformat(),
        "targets": steps["apply-decisions"]["targets"],
        "schedule": steps["plan-observations"]["schedule"],
        "opportunities": steps["predict-access"]["opportunities"],
        "as_run": steps["execute"]["as_run"],
        "burned_area": burned,
        "fire_arrival": arrival,
        "detections": steps["known-at-end"]["detections"],
        "perimeters": inputs.inputs.get("perimeters"),
        "truth": truth,
    }
    scored = {"fire_arrival": arrival, "burned_area": burned, "at": cycle.end.isoformat(), "truth": truth}
    made = {"situation": runner.local(SITUATION, drawn), "score": runner.local(SCORE, scored)}
    if PUBLISHED_ROWS in inputs.inputs:
        made["priority-map"] = map_priorities(runner, inputs, case.title, cycle)
    return made


def _perimeter_scores(run: _CaseRun, inputs: CaseInputs) -> list[Mapping[str, Any]]:
    """For each mapped perimeter: the arrival map from the data up to it only, and its scores."""
    table = read_reference(inputs.inputs["perimeters"], tables.PERIMETERS, run.store).sort_values("time")
    rows = list(table.itertuples())
    scores: list[Mapping[str, Any]] = run.carry_out(
        PERIMETERS, lambda runner: [_score_one(runner, run, inputs, row) for row in rows]
    )
    return scores


def _score_one(runner: Runner, run: _CaseRun, inputs: CaseInputs, row: Any) -> Mapping[str, Any]:
    time: pd.Timestamp = row.time
    given = {name: inputs.inputs.get(name) for name in KNOWN_INPUTS}
    known = runner.local(ASSEMBLE_INPUTS, {"cutoff": time.isoformat(), **given})
    arrival = runner.service(
        "arrival",
        "infer-fire-arrival",
        {
            "detections": known["detections"],
            "incidents": known["incidents"],
            "burned_area": [],  # simulated from these very perimeters: they would score themselves
            "start": (run.case.first_cutoff - timedelta(days=3)).isoformat(),
            "end": time.isoformat(),
            "seed": run.profile.settings.seed,
            **run.profile.settings.arrival,
        },
    )
    scored = {
        "fire_arrival": arrival["fire_arrival"],
        "perimeters": inputs.inputs["perimeters"],
        "incident_id": row.incident_id,
        "time": time.isoformat(),
    }
    values = runner.local(SCORE_PERIMETER, scored)["values"]
    map_of = next(reference for reference in arrival["maps"] if row.incident_id in reference["href"])
    return {"incident_id": row.incident_id, "time": time.isoformat(), "map": map_of, **values}


def _times(case: Case, last: CycleProducts, cutoffs: Sequence[datetime]) -> dict[str, Any]:
    """The time of each part of the case, for its catalogue."""
    parts = {BUNDLE: case.first_cutoff, CALIBRATION: case.first_cutoff, PERIMETERS: last.end, ROWS: last.cutoff}
    parts |= {f"{BUNDLE}-{cycle_label(cutoff)}": cutoff for cutoff in cutoffs}
    return parts | {cycle_label(cutoff): cutoff for cutoff in cutoffs} | {f"{last.label}-{PLAIN}": last.cutoff}
