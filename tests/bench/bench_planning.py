"""Planning benchmarks: ``python -m tests.bench.bench_planning`` prints one JSON object a line.

With SMOKEGLINT_DATA: the two cases of the size of the paper's Table 1. ``*_gap_60s`` is against the upper bound that
the data notes give, ``*_own_gap_60s`` against the bound proven in the run. Each case runs in a fresh process: read,
planned, replayed and reported. Without the variable there is nothing to measure against, and standard error says so.

``--long``: the work that fills 600 s of two quiet cores, the paper's Table 1 beside ours, pre-fire targets alone, and
growth over 7, 15, 30 and 60 simulated satellites (`tests.bench.planning.fleet`, 3,333 targets a satellite).
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

NOTED_BOUNDS = {"la": 48138.3, "tx": 150196.4}
BARS: dict[str, float] = {
    "table1_la_gap_60s": 0.0005, "table1_tx_gap_60s": 0.0035, "active_only_solve_s": 0.1, "active_only_s": 3.0,
    "peak_gb": 2.0,
    "table1_la_gap_600s": 0.0003, "table1_tx_gap_600s": 0.002, "fleet30_gap_600s": 0.01,
    "table1_la_active_share": 1.0, "table1_tx_active_share": 1.0,
}  # fmt: skip


def emit(name: str, value: float, unit: str) -> None:
    print(json.dumps({"name": name, "value": value, "unit": unit, "bar": BARS.get(name)}), flush=True)


def read_case(folder: Path, craft: str) -> tuple[dict[str, Any], Any]:
    """Contract tables and spacecraft of one case."""
    from services.planning.spacecraft_limits import read_spacecraft
    from shared.contracts import tables
    from shared.contracts.schema import read_table

    names = ("opportunities", "targets", "contacts", "eclipses")
    frames = {name: read_table(folder / f"{name}.parquet", tables.ALL[name.upper()]) for name in names}
    return frames, read_spacecraft(json.loads((folder / craft).read_text()))


WORK = {"60s": 20.0, "600s": 380.0}
GUARD_S = {"60s": 55.0, "600s": 3600.0}
"""Guards only: on two quiet cores the counted work ends well before 60 s and 600 s."""
FLEETS = (7, 15, 30, 60)
FLEET_WORK = {7: 10.0, 15: 60.0, 30: 10.0, 60: 5.0}
TARGETS_PER_SATELLITE = 100_000 / 30


def measure(case: str, craft: str, kind: str, budget: str) -> dict[str, Any]:
    """Plan one case in this process; ``kind`` limits the targets (``all``, ``active``, ``prefire``)."""
    from services.planning.operations import make_plan
    from services.planning.planner import Options

    started = time.perf_counter()
    if case.isdigit():
        from tests.bench.planning.fleet import fleet_case

        frames, spacecraft = fleet_case(int(case), round(int(case) * TARGETS_PER_SATELLITE))
        started = time.perf_counter()
    else:
        folder = Path(os.environ["SMOKEGLINT_DATA"]) / f"planning/table1-{case}"
        frames, spacecraft = read_case(folder, craft)
    if kind != "all":
        targets = frames["targets"][frames["targets"]["kind"] == kind]
        seen = frames["opportunities"]
        frames |= {"targets": targets, "opportunities": seen[seen["target_id"].isin(targets["target_id"])]}
    work = FLEET_WORK[int(case)] if case.isdigit() else WORK[budget]
    options = Options(mip_gap=0.0001, time_limit_s=GUARD_S[budget], work_limit=work)
    stamps: dict[str, float] = {}
    made = make_plan(
        frames, spacecraft, options=options, progress=lambda _, text: stamps.setdefault(text, time.perf_counter())
    )
    return {
        "seconds": time.perf_counter() - started, "solve_s": stamps["exact timeline"] - stamps["solving"],
        "plan_s": stamps["replay"] - started, "time_limited": made.plan.time_limited,
        **outcome(made.plan, made.report), "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }  # fmt: skip


def outcome(plan: Any, report: dict[str, Any]) -> dict[str, Any]:
    planned = report["targets"]
    prefire_bound = plan.bound - planned["active"]["reward_planned"]
    return {
        "objective": plan.objective, "bound": plan.bound, "own_gap": plan.gap,
        "available": sum(part["reward_available"] for part in planned.values()), "targets": planned,
        "active_share": planned["active"]["planned"] / max(1, planned["active"]["available"]),
        "prefire_share": planned["prefire"]["planned"] / max(1, planned["prefire"]["available"]),
        "prefire_gap": 1 - planned["prefire"]["reward_planned"] / prefire_bound if prefire_bound > 0 else 0.0,
        "greedy_gap": report["greedy_baseline"]["gap"],
    }  # fmt: skip


def in_fresh_process(case: str, craft: str, kind: str, budget: str = "60s") -> dict[str, Any]:
    command = [sys.executable, "-m", "tests.bench.bench_planning", case, craft, kind, budget]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def table_row(test: str, gap: float, seconds: float | str, values: tuple[Any, ...], source: str) -> None:
    """One row in the form of the paper's Table 1; the value is the gap."""
    reward, available, *targets = values
    row = {
        "name": f"table1 {source}: {test}", "value": gap, "unit": "1", "bar": None, "solve_time": seconds,
        "reward_planned": reward, "reward_available": available, "reward_share": reward / available,
        "active_planned": targets[0], "active_available": targets[1], "prefire_planned": targets[2],
        "prefire_available": targets[3],
    }  # fmt: skip
    print(json.dumps(row), flush=True)


def our_row(test: str, result: dict[str, Any]) -> None:
    counts = [result["targets"][kind][part] for kind in ("active", "prefire") for part in ("planned", "available")]
    values = (result["objective"], result["available"], *counts)
    table_row(test, result["own_gap"], round(result["seconds"], 2), values, "ours")


def measure_case(case: str, budget: str) -> float:
    """Figures of one of the two cases; returns its peak memory, GB."""
    noted = NOTED_BOUNDS[case]
    result = in_fresh_process(case, "spacecraft.json", "all", budget)
    emit(f"table1_{case}_gap_{budget}", (noted - result["objective"]) / noted, "1")
    emit(f"table1_{case}_own_gap_{budget}", result["own_gap"], "1")
    emit(f"table1_{case}_prefire_gap_{budget}", result["prefire_gap"], "1")
    emit(f"table1_{case}_s" if budget == "60s" else f"table1_{case}_s_{budget}", result["seconds"], "s")
    emit(f"table1_{case}_time_limited_{budget}", float(result["time_limited"]), "1")
    if budget == "60s":
        for name in ("active_share", "prefire_share", "greedy_gap"):
            emit(f"table1_{case}_{name}", result[name], "1")
    our_row(f"{case}, active and pre-fire, {budget}", result)
    return float(result["peak_gb"])


def short() -> None:
    in_fresh_process("la", "spacecraft.json", "active")  # compiled code cached, as in a warm service
    active = in_fresh_process("la", "spacecraft.json", "active")
    emit("active_only_solve_s", active["solve_s"], "s")
    emit("active_only_s", active["seconds"], "s")
    emit("active_only_gap", active["own_gap"], "1")
    peak = max(measure_case(case, "60s") for case in NOTED_BOUNDS)
    tight = in_fresh_process("la", "spacecraft_tight.json", "all")
    emit("tight_la_gap_60s", tight["own_gap"], "1")
    emit("tight_la_s", tight["seconds"], "s")
    emit("peak_gb", max(peak, tight["peak_gb"]), "GB")


def long() -> None:
    from flows.cases.paper_days.published_rows import PUBLISHED_ROWS

    for test, gap, seconds, *rest in PUBLISHED_ROWS:
        table_row(test, gap, seconds, tuple(rest), "paper")
    for case in NOTED_BOUNDS:
        our_row(f"{case}, active only", in_fresh_process(case, "spacecraft.json", "active"))
        alone = in_fresh_process(case, "spacecraft.json", "prefire")
        emit(f"prefire_only_{case}_share", alone["prefire_share"], "1")
        emit(f"prefire_only_{case}_gap", alone["own_gap"], "1")
        measure_case(case, "600s")
    emit("tight_tx_gap_60s", in_fresh_process("tx", "spacecraft_tight.json", "all")["own_gap"], "1")
    for size in FLEETS:
        fleet = in_fresh_process(str(size), "", "all", "600s")
        emit(f"fleet{size}_gap_600s", fleet["own_gap"], "1")
        emit(f"fleet{size}_prefire_gap_600s", fleet["prefire_gap"], "1")
        emit(f"fleet{size}_plan_s", fleet["plan_s"], "s")
        emit(f"fleet{size}_peak_gb", fleet["peak_gb"], "GB")


def keep_lines_apart() -> None:
    """Standard output for our JSON lines alone: HiGHS writes a word of its own there, which goes to standard error."""
    sys.stdout.flush()
    own = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = os.fdopen(own, "w", encoding="utf-8")


def main() -> None:
    if not os.environ.get("SMOKEGLINT_DATA"):
        print("SMOKEGLINT_DATA is not set: nothing to measure", file=sys.stderr)
        return
    short()
    if "--long" in sys.argv[1:]:
        long()


if __name__ == "__main__":
    keep_lines_apart()
    if len(sys.argv) == 5:
        print(json.dumps(measure(*sys.argv[1:])))
    else:
        main()
