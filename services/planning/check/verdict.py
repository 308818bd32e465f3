"""What a replay says: the first violation of every rule, and what the schedule collects."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Violation:
    """A broken rule: which, by which satellite, at which second from horizon_start, and in words."""

    rule: str
    satellite: str
    second: int
    detail: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.satellite} at second {self.second}: {self.detail}"


@dataclass(frozen=True)
class Verdict:
    """``violations`` holds the first of every broken rule, in order of time; ``images`` those collected.

    ``objective`` is equation 1 under the target changes; ``dropped_images`` counts images of the previous plan that
    could have been kept and were not, which cost ``change_cost``; ``fragile_targets`` those observed only by looks that
    the along-track error may spoil, which cost ``fragile_cost``.
    """

    violations: tuple[Violation, ...]
    images: tuple[int, ...]
    objective: float
    stored_at_end: dict[str, int] = field(default_factory=dict)
    battery_at_end_wh: dict[str, float] = field(default_factory=dict)
    dropped_images: int = 0
    change_cost: float = 0.0
    fragile_targets: int = 0
    fragile_cost: float = 0.0

    @property
    def valid(self) -> bool:
        return not self.violations


class ViolationLog:
    """Keeps the earliest violation of every rule."""

    def __init__(self) -> None:
        self.first: dict[str, Violation] = {}

    def add(self, rule: str, satellite: str, second: int, detail: str) -> None:
        known = self.first.get(rule)
        if known is None or (second, satellite) < (known.second, known.satellite):
            self.first[rule] = Violation(rule, satellite, second, detail)

    def ordered(self) -> tuple[Violation, ...]:
        return tuple(sorted(self.first.values(), key=lambda v: (v.second, v.satellite, v.rule)))
