"""How much work each shipped case is given: enough for a fair product, little enough for an ordinary machine."""

from __future__ import annotations

from dataclasses import dataclass, replace

from flows.loop_types import LoopSettings

PAPER_DAYS = ("la-2025", "smokehouse-2024", "conus-2023-07-05")


@dataclass(frozen=True)
class Profile:
    """Loop settings of a case, and the history that its calibration looks back on.

    The shipped cases count a target as covered within 5 km: a raw-IF footprint over land is kilometres wide, and in a
    region this small a wider radius would leave the planner nothing to choose.
    """

    settings: LoopSettings
    calibration_days: int
    calibration_step_s: int


_TINY = Profile(
    LoopSettings(
        target_radius_km=5.0,
        targets={"active_spacing_km": 5, "prefire_spacing_deg": 0.1},
        planning={"time_limit_s": 60},
        arrival={"cell_m": 1000, "epochs": 20, "ensemble": 2, "formats": ["pictures"]},
    ),
    calibration_days=6,
    calibration_step_s=1,
)
_DEMO = Profile(
    LoopSettings(
        target_radius_km=5.0,
        targets={"active_spacing_km": 4, "prefire_spacing_deg": 0.05},
        planning={"time_limit_s": 120},
        arrival={"cell_m": 500},
    ),
    calibration_days=10,
    calibration_step_s=1,
)
# A day of the paper: the whole country for 24 h. What is observed there is simulated, so little is spent on it, and on
# the plan of the loop, which the rows beside the paper's follow with plans of their own.
_PAPER_DAY = Profile(
    LoopSettings(
        overlap_hours=0,
        targets={"active_spacing_km": 10, "prefire_spacing_deg": 0.1087},
        planning={"time_limit_s": 300, "mip_gap": 0.02, "work_limit": 4},
        arrival={"cell_m": 1000, "epochs": 10, "ensemble": 2, "formats": ["pictures"]},
        map_seen_fires_only=True,
    ),
    calibration_days=2,
    calibration_step_s=20,
)
_LIVE = replace(_DEMO, calibration_days=6, calibration_step_s=5)
_PROFILES = {"tiny": _TINY, "live": _LIVE, **dict.fromkeys(PAPER_DAYS, _PAPER_DAY)}


def profile_of(case: str, cycle_hours: int = 24) -> Profile:
    """The profile of a shipped case, or that of ``demo`` for any other."""
    profile = _PROFILES.get(case, _DEMO)
    return replace(profile, settings=replace(profile.settings, cycle_hours=cycle_hours))
