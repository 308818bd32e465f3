"""What people decided, who, when and why: a log of small files that is only ever added to."""

from __future__ import annotations

import hashlib
import re
import uuid
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, Literal, Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError, model_validator

from flows.root import ArtifactRoot, documents, keep_document
from shared.errors import DomainError

Action = Literal["approve", "reject", "add", "pin", "exclude", "reweight", "release"]
TARGET_ACTIONS = ("pin", "exclude", "reweight", "release")
REWARDS = {"active": (0.1, 1.0), "prefire": (0.0, 0.9)}  # of a target by kind: the one scale of the targets contract
_FIRST_ADDED_ID = 8_000_000_000_000_000  # lattice ids have 18 digits; below 2^53, so exact in JSON readers, too
_LABEL = r"^\d{8}T\d{4}Z$"


class Decision(BaseModel):
    """One decision. It holds from the cycle ``cycle`` on, to ``until`` (included) where that is given.

    ``approve`` and ``reject`` are of one plan, told by the hash of its schedule, and of no other that may follow it.
    ``release`` takes back what was decided about a target before; of an added target, the target itself.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    id: str = Field(default_factory=lambda: uuid.uuid4().hex, pattern=r"^[0-9a-f]{32}$")
    at: AwareDatetime = Field(default_factory=lambda: datetime.now(UTC), description="when it was decided")
    who: str = Field(min_length=1, max_length=128)
    why: str = Field(min_length=1, max_length=2000)
    action: Action
    cycle: str = Field(pattern=_LABEL, description="cut-off of the first cycle it holds for")
    until: str | None = Field(None, pattern=_LABEL)
    schedule_sha256: str = Field("", pattern=r"^([0-9a-f]{64})?$")
    target_id: int | None = None
    priority: float | None = Field(None, ge=0, allow_inf_nan=False, description="reward of equation 1")
    kind: Literal["active", "prefire"] | None = None
    longitude_deg: float | None = Field(None, ge=-180, le=180)
    latitude_deg: float | None = Field(None, ge=-90, le=90)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        needed: dict[str, tuple[str, ...]] = {
            "approve": ("schedule_sha256",),
            "reject": ("schedule_sha256",),
            "add": ("kind", "priority", "longitude_deg", "latitude_deg"),
            "reweight": ("target_id", "priority"),
        }
        for name in needed.get(self.action, ("target_id",)):
            if getattr(self, name) in (None, ""):
                raise ValueError(f"to {self.action} needs '{name}'")
        return self

    def holds_in(self, cycle: str) -> bool:
        """Whether it counts for the cycle of that cut-off."""
        return self.cycle <= cycle and (self.until is None or cycle <= self.until)


class DecisionLog:
    """The decisions about one case: a file each under ``{root}/{case}/.decisions``."""

    def __init__(self, root: ArtifactRoot, case: str) -> None:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+-]*", case):
            raise DomainError(f"'{case}' cannot be the name of a case.", field="case", value=case)
        self._root, self._folder = root, f"{case}/.decisions"

    def append(self, decision: Decision) -> Decision:
        """Keep a decision: written whole or not at all."""
        name = f"{decision.at.astimezone(UTC):%Y%m%dT%H%M%S%f}-{decision.id}.json"
        content = decision.model_dump_json(indent=1, exclude_none=True) + "\n"
        keep_document(self._root, f"{self._folder}/{name}", content.encode())
        return decision

    def all(self) -> list[Decision]:
        """Every decision, oldest first; DomainError names a file that is none."""
        found = []
        for name, content in documents(self._root, self._folder, ".json"):
            try:
                found.append(Decision.model_validate_json(content))
            except ValidationError as error:
                raise DomainError(f"The decision {name} cannot be read: {error}", field=name) from error
        return sorted(found, key=lambda decision: (decision.at, decision.id))


def target_changes(decisions: Iterable[Decision], cycle: str) -> list[dict[str, Any]]:
    """What is in force about single targets in a cycle, as ``plan-observations`` takes it, ordered by target.

    The latest word about a target counts; a pin and a new weight stand beside each other, an exclusion alone.
    """
    in_force: dict[int, dict[str, Decision]] = {}
    for decision in decisions:
        if decision.action not in TARGET_ACTIONS or decision.target_id is None or not decision.holds_in(cycle):
            continue
        own = in_force.setdefault(decision.target_id, {})
        if decision.action in ("exclude", "release"):
            own.clear()
        own.pop("exclude", None)
        if decision.action != "release":
            own[decision.action] = decision
    return [_change(own[action]) for target in sorted(in_force) for own in [in_force[target]] for action in sorted(own)]


def _change(decision: Decision) -> dict[str, Any]:
    change = {"target_id": decision.target_id, "action": decision.action, "priority": decision.priority}
    told = {"who": decision.who, "why": decision.why, "when": decision.at.astimezone(UTC).isoformat()}
    return {name: value for name, value in (change | told).items() if value is not None}


def additions(decisions: Iterable[Decision], cycle: str) -> list[dict[str, Any]]:
    """The targets that people added for a cycle, the latest word about each; one excluded or released since is none."""
    added: dict[int, dict[str, Any]] = {}
    for decision in decisions:
        if not decision.holds_in(cycle):
            continue
        if decision.action == "add":
            added[added_id(decision)] = {
                "kind": decision.kind,
                "priority": decision.priority,
                "longitude_deg": decision.longitude_deg,
                "latitude_deg": decision.latitude_deg,
                "source": f"added by {decision.who}: {decision.why}",
            }
        elif decision.action in ("exclude", "release"):
            added.pop(decision.target_id or 0, None)
    return list(added.values())


def added_id(item: Any) -> int:
    """The id of an added target: of its kind and place (to 0.0001 degree), so that it is the same in every cycle."""
    text = f"{item.kind} {item.longitude_deg:.4f} {item.latitude_deg:.4f}"
    return _FIRST_ADDED_ID + int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")


def verdict_on(decisions: Iterable[Decision], schedule_sha256: str) -> Decision | None:
    """The latest approval or rejection of that very plan; None while it is a draft."""
    about = [d for d in decisions if d.action in ("approve", "reject") and d.schedule_sha256 == schedule_sha256]
    return about[-1] if about else None


def keep(root: ArtifactRoot, case: str, **decided: Any) -> Decision:
    """Check a decision and keep it; DomainError says what is wrong with it."""
    try:
        decision = Decision(**{name: value for name, value in decided.items() if value not in (None, "")})
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise DomainError(f"This is no decision: {where} {first['msg']}".strip(), field=where) from error
    if decision.action == "add" and decision.kind is not None:
        low, high = REWARDS[decision.kind]
        if not low <= (decision.priority or 0.0) <= high:  # kept, it would end every later cycle
            accepted = f"{low:g} to {high:g}"
            text = f"A target that is {decision.kind} has no such reward."
            raise DomainError(text, field="priority", value=decision.priority, accepted=accepted)
    return DecisionLog(root, case).append(decision)
