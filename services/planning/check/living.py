"""One satellite second by second: storage, battery, and whether commands already on board run on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from services.planning.check.reading import Row
from services.planning.check.verdict import ViolationLog

ENERGY_TOLERANCE_WH = 1e-9


@dataclass(frozen=True)
class OnBoard:
    """Commands of the previous plan that run on: second -> (command, station); where they cannot run at all."""

    commands: Mapping[int, tuple[str, str | None]]
    blocked: frozenset[int]
    """Seconds in which the satellite is unavailable, the contact is lost or the station serves another."""


def live(
    name: str, own: Mapping[int, Row], dark: set[int], craft: Mapping[str, Any], horizon_s: int, board: OnBoard,
    log: ViolationLog,
) -> tuple[int, float]:  # fmt: skip
    """Storage and battery of one satellite through the horizon; returns both at its end."""
    stored, progress = int(craft["stored_images_initial"]), 0
    battery = float(craft["battery_initial_wh"])
    for second in range(horizon_s):
        base = (0.0 if second in dark else craft["generation_w"]) - craft["nominal_w"]
        power = base
        row = own.get(second)
        if row is None and second in board.commands and second not in board.blocked:
            if _runs(board.commands[second][0], stored, battery, base, craft):
                log.add("frozen", name, second, f"a {board.commands[second][0]} already on board is left out")
        elif row is not None and row.command == "collect":
            power -= craft["collect_w"]
            stored += 1
            if stored > craft["storage_images"]:
                log.add("storage", name, second, f"{stored} images in a store of {craft['storage_images']}")
        elif row is not None:
            power -= craft["downlink_w"]
            if stored <= 0:
                log.add("empty", name, second, "downlink with empty storage")
            else:
                progress += 1
                if progress == craft["downlink_s_per_image"]:
                    stored, progress = stored - 1, 0
        battery = min(craft["battery_capacity_wh"], battery + power / 3600.0)
        if battery < craft["battery_min_wh"] - ENERGY_TOLERANCE_WH:
            log.add("battery", name, second, f"{battery:.4f} Wh is below the floor of {craft['battery_min_wh']:g} Wh")
    return stored, battery


def _runs(command: str, stored: int, battery: float, base_w: float, craft: Mapping[str, Any]) -> bool:
    """Whether the spacecraft could have run a command here: room or data, and clearly enough charge."""
    draw = craft["collect_w"] if command == "collect" else craft["downlink_w"]
    fits = stored < craft["storage_images"] if command == "collect" else stored > 0
    enough = battery + (base_w - draw) / 3600.0 >= craft["battery_min_wh"] + ENERGY_TOLERANCE_WH
    return bool(fits and enough)
