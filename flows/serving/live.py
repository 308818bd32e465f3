"""One turn of the loop as it runs by itself: what is due now is run, what is finished is answered from the store."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime

from flows.case_store import import_into_store
from flows.cases.bundle import Case, read_case
from flows.cases.live.build import NAME as LIVE
from flows.cases.live.bundles import add_bundle, has_bundle, read_frame
from flows.demo import build_case, named_services
from flows.desk.approval import PeopleDecide
from flows.desk.decisions import DecisionLog
from flows.desk.standing import plan_standings
from flows.ingest.sources import fetch_all
from flows.loop_types import BUNDLE, FEEDBACKS, cycle_label
from flows.profiles import profile_of
from flows.root import work_folder
from flows.root_lock import only_run
from flows.runner import DirectRunner, StepEvent, open_store
from flows.services import running_services, wait_until_ready
from flows.serving.due import Missed, cycles_begun, cycles_to_run, hour_of
from flows.serving.ratings import rate_hour, ratings_label
from shared.telemetry import logger


@dataclass(frozen=True)
class LiveSettings:
    """What an operator sets once. ``services`` names running ones; without it they are started for the turn."""

    case: str
    root: str
    services: str = ""
    approve: bool = True
    missed: Missed = "catch-up"
    cycle_hours: int = 24


def run_due_cycles(settings: LiveSettings, now: datetime) -> str:
    """Go through the cycles that are due, as far as each can be taken by now; a line says how far that was."""
    from flows.case_run import run_case
    from flows.cycle import PrefectConductor  # prefect reads its settings when it is imported

    with only_run(settings.root):
        case = _present_case(settings, now)
        begun = min(cycles_begun(case.first_cutoff, settings.cycle_hours, now), case.cycles)
        if begun == 0:
            return f"The first cycle of {case.name} begins at {case.first_cutoff:%Y-%m-%d %H:%M} UTC."
        numbers = cycles_to_run(begun, _planned(settings, case), settings.missed)
        with _services(settings) as urls:
            store = open_store(settings.root, case.folder)
            profile = profile_of(settings.case, settings.cycle_hours)
            desk = PeopleDecide.of_case(settings.root, case.name, automatic=settings.approve)
            feedback = frozenset(FEEDBACKS)
            given = (PrefectConductor(), case, store, settings.root, urls, _log_step, profile, feedback, numbers)
            result = run_case(*given, again_plain=False, desk=desk, now=now)
    last = f"{result.cycles[-1].label} is finished" if result.cycles else "no cycle is finished"
    return f"{case.name}: {last}. {result.paused or ''}".strip()


def rate_now(settings: LiveSettings, now: datetime) -> str:
    """Rate the active fires known at the hour that has begun."""
    hour = hour_of(now)
    with only_run(settings.root, wait_s=1800.0):
        case = _present_case(settings, now)
        case = read_case(case.bundles[-1]) if case.bundles else case
        with _services(settings) as urls:
            store = open_store(settings.root, case.folder)
            bundle = DirectRunner(urls, store, f"{case.name}-{BUNDLE}", _log_step, case.name, BUNDLE)
            label = ratings_label(hour)
            runner = DirectRunner(urls, store, f"{case.name}-{label}", _log_step, case.name, label)
            rated = rate_hour(runner, import_into_store(bundle, case), hour)
    return f"{case.name}: ratings of {hour:%Y-%m-%d %H:%M} UTC in {rated['ratings']['href']}"


def _present_case(settings: LiveSettings, now: datetime) -> Case:
    """The case; of the live one, where its cycle has no bundle yet, the providers are asked and the bundle is made."""
    if settings.case == LIVE and not has_bundle(work_folder(settings.root), now):
        frame = read_frame(work_folder(settings.root))
        for line in fetch_all(frame.area, frame.ingested, now).said:
            logger().info("fetched", source=line)
        add_bundle(work_folder(settings.root), now)
    return build_case(settings.case, settings.root)


def _planned(settings: LiveSettings, case: Case) -> set[int]:
    """The numbers of the cycles that have a plan."""
    decisions = DecisionLog(settings.root, case.name).all()
    labels = {standing.cycle for standing in plan_standings(settings.root, case.name, decisions)}
    numbers = range(1, case.cycles + 1)
    return {number for number in numbers if cycle_label(case.cutoff(number, settings.cycle_hours)) in labels}


@contextmanager
def _services(settings: LiveSettings) -> Iterator[Mapping[str, str]]:
    if settings.services:
        yield named_services(settings.services)
        return
    with running_services(settings.root) as urls:
        wait_until_ready(urls)
        yield urls


def _log_step(event: StepEvent) -> None:
    if event.done:
        logger().info("step finished", cycle=event.cycle, process=event.process, seconds=round(event.seconds, 2))
