"""Functions that a fan-out's workers import."""

import os
from pathlib import Path

import numpy as np


def noise(seed: int, size: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=size)


def die_once(index: int, mark: str) -> int:
    """Kills its own process the first time task 2 is met."""
    if index == 2 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), 9)
    return index


def die(index: int) -> int:
    os.kill(os.getpid(), 9)
    return index


def refuse(index: int) -> int:
    raise ValueError(f"task {index}")
