"""Every possible sequence of commands of tiny cases, tried out: the oracle for recordings, switches, slews, budgets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from services.planning.options.rules import OperationRules
from tests.services.planning.planning_cases import Case


class State(NamedTuple):
    """One satellite after some seconds."""

    stored: int
    progress: int
    battery: float
    command: tuple[str, str]
    """Kind and place of the command of the last second; ("", "") where idle."""
    length: int
    """Seconds that it has lasted, up to what matters."""
    kind: str
    """Kind of the last command at all."""
    idle: int
    """Idle seconds since then, up to what matters."""
    pointing: str
    still: int
    """Seconds since the last recording, up to what matters."""
    commands: int


IDLE = ("", "")


def best_sequence(case: Case, rules: OperationRules) -> float:
    """Highest objective over all sequences of commands that keep the contract and ``rules`` (one UTC day)."""
    craft = case.spacecraft
    names = sorted({image[1] for image in case.images} | {contact[0] for contact in case.contacts})
    first = State(0, 0, craft.battery_initial_wh, IDLE, 0, "", 99, craft_pointing(case), 0, 0)
    first = first._replace(battery=round(craft.battery_initial_wh, 9))
    states = {(0, tuple(first for _ in names))}
    for second in range(craft.horizon_s):
        reached = set()
        for mask, fleet in states:
            partial: list[tuple[int, tuple[State, ...], frozenset[str]]] = [(mask, (), frozenset())]
            for name, state in zip(names, fleet, strict=True):
                steps = list(_steps(case, rules, name, state, second))
                partial = [
                    (seen | extra, (*done, after), used | taken)
                    for seen, done, used in partial
                    for extra, after, taken in steps
                    if not used & taken
                ]
            reached.update((seen, done) for seen, done, _ in partial)
        states = reached
    whole = [seen for seen, fleet in states if all(_may_end(state, rules) for state in fleet)]
    return max(_value(case, seen) for seen in set(whole))


def craft_pointing(case: Case) -> str:
    """Pointing at the start ("": any)."""
    states = [state.pointing_initial for state in case.spacecraft.satellites.values()]
    return states[0] or "" if states else ""


def _may_end(state: State, rules: OperationRules) -> bool:
    return state.command[0] != "collect" or state.length >= rules.min_collect_s


def _steps(
    case: Case, rules: OperationRules, name: str, state: State, second: int
) -> Iterator[tuple[int, State, frozenset[str]]]:
    """(images collected as bits, state after, stations used) of everything a satellite may do in a second."""
    craft = case.spacecraft
    dark = any(s == name and a < second + 1 and b > second for s, a, b in case.eclipses)
    base = (0.0 if dark else craft.generation_w) - craft.nominal_w
    choices: list[tuple[tuple[str, str], int, float]] = [(IDLE, 0, 0.0)]
    for pointing in sorted(set(case.pointing.values())) or [""]:
        bits = sum(
            1 << number
            for number, (i, s, t, _) in enumerate(case.images)
            if s == name and t == second and case.pointing.get(i, "") == pointing
        )
        if (bits or rules.min_collect_s > 1) and state.stored < craft.storage_images:
            choices.append((("collect", pointing), bits, craft.collect_w))
    for s, station, a, b in case.contacts:
        if s == name and a <= second and second + 1 <= b and state.stored > 0:
            choices.append((("downlink", station), 0, craft.downlink_w))
    for command, bits, watts in choices:
        charge = min(craft.battery_capacity_wh, state.battery + (base - watts) / 3600.0)
        if charge >= craft.battery_min_wh - 1e-9 and _allowed(case, rules, state, command, second):
            after = _after(case, rules, state, command)._replace(battery=round(charge, 9))
            yield bits, after, frozenset([command[1]]) if command[0] == "downlink" else frozenset()


def _allowed(case: Case, rules: OperationRules, state: State, command: tuple[str, str], second: int) -> bool:
    if command != state.command:
        if state.command[0] == "collect" and state.length < rules.min_collect_s:
            return False
        if command != IDLE and rules.max_commands_per_day is not None and state.commands >= rules.max_commands_per_day:
            return False
    if command == IDLE:
        return True
    if state.kind not in ("", command[0]) and state.idle < rules.mode_switch_s:
        return False
    if command[0] == "collect" and state.pointing not in ("", command[1]):
        return state.still >= (case.spacecraft.slew or {})[state.pointing][command[1]]
    return True


def _after(case: Case, rules: OperationRules, state: State, command: tuple[str, str]) -> State:
    craft = case.spacecraft
    stored, progress = state.stored, state.progress
    if command[0] == "collect":
        stored += 1
    elif command[0] == "downlink":
        progress += 1
        if progress == craft.downlink_s_per_image:
            stored, progress = stored - 1, 0
    new = command not in (IDLE, state.command)
    longest = max([0, *(v for row in (craft.slew or {}).values() for v in row.values())])
    return State(
        stored, progress, 0.0, command, min(rules.min_collect_s, 1 if new else state.length + 1),
        command[0] or state.kind, 0 if command != IDLE else min(max(1, rules.mode_switch_s), state.idle + 1),
        command[1] if command[0] == "collect" else state.pointing,
        0 if command[0] == "collect" else min(longest, state.still + 1),
        state.commands + new if rules.max_commands_per_day is not None else 0,
    )  # fmt: skip


def _value(case: Case, mask: int) -> float:
    seen = {t for number, (_, _, _, covered) in enumerate(case.images) if mask >> number & 1 for t in covered}
    return sum((10 if kind == "active" else 1) * r for t, (kind, r) in case.rewards.items() if t in seen)
