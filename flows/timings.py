"""How long each step took on this machine: a log in the work folder, since no clock may enter a product."""

from __future__ import annotations

import json
from pathlib import Path

FOLDER = ".timings"


def note_seconds(root: Path, case: str, cycle: str, process: str, step: str, seconds: float) -> None:
    """Add a line; ``step`` is the folder of the finished step. One writer a root (the loop holds the root's lock)."""
    folder = root / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    line = {"cycle": cycle, "process": process, "step": step, "seconds": round(seconds, 3)}
    with (folder / f"{case}.jsonl").open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(line, sort_keys=True) + "\n")


def step_seconds(root: Path, case: str) -> dict[str, dict[str, float]]:
    """Seconds that each process took, by cycle: its steps added up, each as long as when it was made.

    Answers from the store are in the log as well; the longest time of a step is the one in which it was made. A line
    that a killed run left unfinished is passed over.
    """
    file = root / FOLDER / f"{case}.jsonl"
    longest: dict[tuple[str, str, str], float] = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else []:
        try:
            told = json.loads(line)
            name = (told["cycle"], told["process"], told["step"])
            longest[name] = max(longest.get(name, 0.0), float(told["seconds"]))
        except (ValueError, KeyError, TypeError):
            continue
    summed: dict[str, dict[str, float]] = {}
    for (cycle, process, _), seconds in longest.items():
        of_cycle = summed.setdefault(cycle, {})
        of_cycle[process] = of_cycle.get(process, 0.0) + seconds
    return summed
