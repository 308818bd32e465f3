"""A plan is a draft until a person, or a setting, approves it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Protocol

from flows.desk.decisions import Decision, DecisionLog, additions, target_changes, verdict_on
from flows.root import ArtifactRoot


class CyclePaused(Exception):
    """A cycle that can go no further yet; the loop goes on when it is run again."""

    def __init__(self, cycle: str, text: str) -> None:
        super().__init__(text)
        self.cycle = cycle


class CycleUnderWay(CyclePaused):
    """The plan is on board and being executed: what it brings is there at the end of the cycle."""

    def __init__(self, cycle: str, end: datetime) -> None:
        super().__init__(cycle, f"Cycle {cycle} is being executed until {end:%Y-%m-%d %H:%M} UTC.")


class AwaitingApproval(CyclePaused):
    """The plan of a cycle is a draft; the loop goes on when it is run again after an approval."""

    def __init__(self, cycle: str, schedule: Mapping[str, Any], rejected: Decision | None = None) -> None:
        state = f"was rejected by {rejected.who} ({rejected.why})" if rejected else "awaits approval"
        super().__init__(cycle, f"The plan of cycle {cycle} {state}.")
        self.schedule = schedule
        self.rejected = rejected


class Desk(Protocol):
    """What the loop asks of those who decide."""

    def target_changes(self, cycle: str) -> list[dict[str, Any]]:
        """Single targets pinned, excluded or re-weighted."""

    def additions(self, cycle: str) -> list[dict[str, Any]]:
        """Targets added by hand."""

    def approval(self, cycle: str, schedule: Mapping[str, Any], release: datetime) -> dict[str, str]:
        """Who approved the plan and when; AwaitingApproval while nobody has."""


@dataclass(frozen=True)
class PeopleDecide:
    """Decisions from a case's log. With ``automatic`` a plan that nobody rejected counts as approved at its release."""

    log: DecisionLog
    automatic: bool = False

    @classmethod
    def of_case(cls, root: ArtifactRoot, case: str, *, automatic: bool) -> PeopleDecide:
        return cls(DecisionLog(root, case), automatic)

    def target_changes(self, cycle: str) -> list[dict[str, Any]]:
        return target_changes(self.log.all(), cycle)

    def additions(self, cycle: str) -> list[dict[str, Any]]:
        return additions(self.log.all(), cycle)

    def approval(self, cycle: str, schedule: Mapping[str, Any], release: datetime) -> dict[str, str]:
        verdict = verdict_on(self.log.all(), str(schedule["sha256"]))
        if verdict is not None and verdict.action == "approve":
            return {"approved_by": verdict.who, "approved_at": verdict.at.astimezone(UTC).isoformat()}
        if verdict is None and self.automatic:
            return {"approved_by": "setting", "approved_at": release.astimezone(UTC).isoformat()}
        raise AwaitingApproval(cycle, schedule, verdict)


class NobodyDecides:
    """No changes by hand, and every plan approved by setting: for comparisons and tests."""

    def target_changes(self, cycle: str) -> list[dict[str, Any]]:
        return []

    def additions(self, cycle: str) -> list[dict[str, Any]]:
        return []

    def approval(self, cycle: str, schedule: Mapping[str, Any], release: datetime) -> dict[str, str]:
        return {"approved_by": "setting", "approved_at": release.astimezone(UTC).isoformat()}
