"""GPS C/A codes (IS-GPS-200, section 3.3.2.3): the Gold codes of PRN 1-32."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import CODE_LENGTH_CHIPS
from shared.errors import DomainError

# Phase-selector taps of the G2 register, PRN 1-32 (IS-GPS-200, table 3-Ia).
G2_TAPS = (
    (2, 6), (3, 7), (4, 8), (5, 9), (1, 9), (2, 10), (1, 8), (2, 9), (3, 10), (2, 3), (3, 4), (5, 6), (6, 7), (7, 8),
    (8, 9), (9, 10), (1, 4), (2, 5), (3, 6), (4, 7), (5, 8), (6, 9), (1, 3), (4, 6), (5, 7), (6, 8), (7, 9), (8, 10),
    (1, 6), (2, 7), (3, 8), (4, 9),
)  # fmt: skip


@lru_cache(maxsize=32)
def chips(prn: int) -> NDArray[np.uint8]:
    """The 1023 chips (0 or 1) of one period; DomainError for a PRN that has no C/A code here."""
    if not 1 <= prn <= len(G2_TAPS):
        raise DomainError(f"PRN {prn} has no C/A code here.", field="prn", value=prn, accepted="1..32")
    first, second = G2_TAPS[prn - 1]
    g1, g2 = np.ones(10, dtype=np.uint8), np.ones(10, dtype=np.uint8)
    code = np.empty(CODE_LENGTH_CHIPS, dtype=np.uint8)
    for n in range(CODE_LENGTH_CHIPS):
        code[n] = g1[9] ^ g2[first - 1] ^ g2[second - 1]
        g1 = np.concatenate([[g1[2] ^ g1[9]], g1[:9]])
        g2 = np.concatenate([[g2[1] ^ g2[2] ^ g2[5] ^ g2[7] ^ g2[8] ^ g2[9]], g2[:9]])
    code.setflags(write=False)
    return code


def replica(prn: int, chip_phase: NDArray[np.float64]) -> NDArray[np.float32]:
    """Code values +1/-1 at code phases in chips (any shape, wrapped to one period); chip 0 is +1."""
    index = np.floor(chip_phase).astype(np.int64) % CODE_LENGTH_CHIPS
    return (1.0 - 2.0 * chips(prn)[index]).astype(np.float32)
