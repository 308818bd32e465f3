"""How much work each shipped case is given: enough for a fair product, little enough for an ordinary machine."""

from __future__ import annotations

from dataclasses import dataclass, replace

from flows.loop import LoopSettings


@dataclass(frozen=True)
class Profile:
    """Loop settings of a case, and the history that its calibration looks back on."""

    settings: LoopSettings
    calibration_days: int
    calibration_step_s: int


_TINY = Profile(
    LoopSettings(
        access={"step_s": 1},
        targets={"active_spacing_km": 6, "prefire_spacing_deg": 0.2},
        planning={"time_limit_s": 60},
        arrival={"cell_m": 1000, "epochs": 150, "ensemble": 2},
    ),
    calibration_days=4,
    calibration_step_s=20,
)
_DEMO = Profile(
    LoopSettings(
        targets={"active_spacing_km": 4, "prefire_spacing_deg": 0.1},
        planning={"time_limit_s": 120},
        arrival={"cell_m": 500},
    ),
    calibration_days=6,
    calibration_step_s=10,
)
_PROFILES = {"tiny": _TINY}


def profile_of(case: str, cycle_hours: int = 24) -> Profile:
    """The profile of a shipped case, or that of ``demo`` for any other."""
    profile = _PROFILES.get(case, _DEMO)
    return replace(profile, settings=replace(profile.settings, cycle_hours=cycle_hours))
