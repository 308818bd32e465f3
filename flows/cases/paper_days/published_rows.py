"""The nine planner rows of the paper's Table 1, as published."""

from __future__ import annotations

from typing import Any, NamedTuple


class PublishedRow(NamedTuple):
    """One row: gap when the solver ended, its time, reward planned and available, targets planned and available.

    No pre-fire counts where only active targets were given. Rewards are on the paper's scale, not on ours.
    """

    test: str
    gap: float
    solve_time: str
    reward_planned: float
    reward_available: float
    active_planned: int
    active_available: int
    prefire_planned: int | None
    prefire_available: int | None


KINDS = ("active and pre-fire", "active and pre-fire, gap 0.01", "active only")
LA, TX, CONUS = "LA 2025-01-08", "TX 2024-02-26", "CONUS 2023-07-05"
PUBLISHED_ROWS = (
    PublishedRow(f"{LA}, {KINDS[0]}", 0.005, "3 h", 47993, 48345, 136, 136, 15209, 19034),
    PublishedRow(f"{LA}, {KINDS[1]}", 0.0086, "41 min", 47863, 48345, 136, 136, 14434, 19034),
    PublishedRow(f"{LA}, {KINDS[2]}", 0.0001, "0.01 s", 46741, 46741, 136, 136, None, None),
    PublishedRow(f"{TX}, {KINDS[0]}", 0.007, "3 h", 156294, 157968, 359, 359, 19702, 22119),
    PublishedRow(f"{TX}, {KINDS[1]}", 0.0099, "22.6 min", 155856, 157968, 359, 359, 19427, 22119),
    PublishedRow(f"{TX}, {KINDS[2]}", 0.0001, "0.01 s", 108046, 108046, 359, 359, None, None),
    PublishedRow(f"{CONUS}, {KINDS[0]}", 0.0023, "3 h", 208727, 209617, 367, 367, 19871, 23216),
    PublishedRow(f"{CONUS}, {KINDS[1]}", 0.0056, "22.9 min", 208089, 209617, 367, 367, 19198, 23216),
    PublishedRow(f"{CONUS}, {KINDS[2]}", 0.0001, "0.02 s", 157153, 157153, 367, 367, None, None),
)


def rows_of(day: str) -> list[dict[str, Any]]:
    """The three rows of a day (``LA``, ``TX`` or ``CONUS``), each with its ``kind``."""
    return [row._asdict() | {"kind": row.test[len(day) + 2 :]} for row in PUBLISHED_ROWS if row.test.startswith(day)]
