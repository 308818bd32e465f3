"""How counted work is shared out (annealing, halves chosen exactly, rounds that tighten the bound), and the guard."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

DEFAULT_WORK = 20.0
MOVES_PER_UNIT = 1_000_000
EXACT_SHARE, HALVES_PER_UNIT = 0.2, 0.1
"""Of work beyond the default, the share that goes on exact improvement by halves, and rounds for each unit of it all:
annealing gains little then."""
FIRST_PROOF_SHARE = 0.2
"""Of work up to the default, the share that the odd sets of the first relaxation take."""
UNITS_PER_PROOF, PROOF_COST, MOST_PROOFS = 40.0, 6.0, 6
"""Beyond the default, a round that tightens the bound for every so many units, its cost in units, and the most that
still tell."""

LEAST_GUARD_S = 0.5
"""What a small program gets when no time is left: it ends by itself, or leaves what it has."""


@dataclass(frozen=True)
class Work:
    """Steps of each of two searches, rounds of halves, rounds that tighten the bound."""

    moves: int
    halves: int
    proofs: int


def shared_work(limit: float) -> Work:
    """``limit`` in units of a million search steps on each of two cores."""
    extra = max(0.0, limit - DEFAULT_WORK)
    proofs = min(MOST_PROOFS, int(extra / UNITS_PER_PROOF))
    first = min(limit, DEFAULT_WORK) * FIRST_PROOF_SHARE
    moves = limit - first - extra * EXACT_SHARE - proofs * PROOF_COST
    return Work(int(moves * MOVES_PER_UNIT), int(extra * HALVES_PER_UNIT), proofs)


def guard_s(left: Callable[[], float], most_s: float) -> float:
    """Seconds for one small program: what is ``left``, at most ``most_s``, and a little when nothing is."""
    return max(LEAST_GUARD_S, min(most_s, left()))


@dataclass(frozen=True)
class Clock:
    """The guard: seconds left of ``limit_s`` since ``started``."""

    started: float
    limit_s: float

    def left(self) -> float:
        return self.limit_s - (time.monotonic() - self.started)
