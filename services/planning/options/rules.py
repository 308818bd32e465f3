"""The options of a mission operations centre as plain data, read by the planner and by the replay alike."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

ACTIONS = ("pin", "exclude", "reweight")


@dataclass(frozen=True)
class Outage:
    """A station or a satellite (one of the two) that is out of service in [start, end), or from start on."""

    start: pd.Timestamp
    end: pd.Timestamp | None = None
    satellite: str | None = None
    station: str | None = None
    why: str = ""


@dataclass(frozen=True)
class TargetChange:
    """What a person decided about one target: ``pin``, ``exclude`` or ``reweight`` (to ``priority``), and who, when,
    why."""

    target_id: int
    action: str
    who: str
    why: str
    when: pd.Timestamp
    priority: float | None = None


@dataclass(frozen=True)
class OperationRules:
    """Rules beyond the contract; the defaults demand nothing.

    ``min_collect_s``: shortest recording, an unbroken run of collects. ``mode_switch_s``: idle seconds between
    collecting and downlinking. ``max_commands_per_day``: recordings and unbroken downlinks of one satellite that start
    on one UTC day. ``booked``: rows of satellite, station, start, end outside which no contact may be used.
    ``acquisition_s``: seconds at the start of every usable pass that carry no data. ``nominal_share``: share of every
    usable pass kept for nominal-mode data. ``frozen_until``: commands of the previous plan that start earlier stay.
    ``change_penalty``: reward given up for each image of the previous plan that could be kept and is not.
    ``fragile_discount``: share of a target's reward lost where only looks observe it that the along-track error may
    spoil.
    """

    min_collect_s: int = 1
    mode_switch_s: int = 0
    max_commands_per_day: int | None = None
    booked: pd.DataFrame | None = None
    acquisition_s: float = 0.0
    nominal_share: float = 0.0
    outages: tuple[Outage, ...] = ()
    target_changes: tuple[TargetChange, ...] = ()
    frozen_until: pd.Timestamp | None = None
    change_penalty: float = 0.0
    fragile_discount: float = 0.0

    @property
    def sequenced(self) -> bool:
        """Whether plans must be made of recordings: what totals per data cycle cannot express."""
        return self.min_collect_s > 1 or self.mode_switch_s > 0 or self.max_commands_per_day is not None

    @property
    def free_downlinks(self) -> bool:
        """Whether downlinks may be scattered over single seconds: no switches and no budget of commands forbid it."""
        return self.mode_switch_s == 0 and self.max_commands_per_day is None
