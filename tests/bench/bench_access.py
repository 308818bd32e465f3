"""Access benchmarks: ``python -m tests.bench.bench_access`` prints one JSON object a line.

With SMOKEGLINT_DATA: seven CYGNSS, the GPS constellation of 2020-07-30 and the CONUS points; GMAT and IGS truth. The
day over CONUS runs as the service runs it, from files to committed artifacts, in a fresh process with compiled code
cached; the global case over two worker processes, ``--long`` also with half its receivers. Without the variable there
is nothing to measure against, and standard error says so.
"""

from __future__ import annotations

import csv
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.bench.access import global_day

BARS: dict[str, tuple[str, float | None]] = {
    "conus_day_s": ("s", 8.0),
    "conus_day_peak_gb": ("GB", 2.0),
    "gmat_contact_max_dt_s": ("s", 0.1),
    "gmat_eclipse_max_dt_s": ("s", 0.3),
    "global_day_s": ("s", None),
    "global_day_peak_gb": ("GB", 4.0),
    "global_half_day_s": ("s", None),
    "specular_angle_max_deg": ("deg", 1e-6),
    "gps_sp3_median_km": ("km", 5.0),
}
STATIONS = {
    "station": ["hawaii", "santiago", "dongara"],
    "latitude_deg": [19.0, -33.13, -29.08],
    "longitude_deg": [-155.65, -70.67, 115.58],
    "height_m": [367.0, 723.0, 250.0],
    "mask_deg": [7.0, 7.0, 7.0],
    "datum": ["geodetic", "geodetic", "geodetic"],
}


def emit(name: str, value: float) -> None:
    unit, bar = BARS[name]
    print(json.dumps({"name": name, "value": value, "unit": unit, "bar": bar}), flush=True)


def stage(data: Path, root: Path) -> None:
    """The input files of one CONUS day under an artifact root; FM06 is left out, as in the sky today."""
    import geopandas
    import pandas as pd

    from shared.contracts import tables
    from shared.contracts.schema import write_table

    lines = (data / "orbits/tle_20200730/cygnss.tle").read_text().splitlines()
    kept = [line for i in range(0, len(lines), 3) if "FM06" not in lines[i] for line in lines[i : i + 3]]
    (root / "receivers.tle").write_text("\n".join(kept) + "\n")
    (root / "transmitters.tle").write_text((data / "orbits/tle_20200730/gps.tle").read_text())
    write_table(root / "stations.parquet", pd.DataFrame(STATIONS), tables.STATIONS)
    with (data / "grids/conus_prefire_points.csv").open() as file:
        rows = [(float(row[0]), float(row[1])) for row in list(csv.reader(file))[1:]]
    frame = geopandas.GeoDataFrame(
        {"target_id": range(len(rows)), "kind": "prefire", "priority": 0.1},
        geometry=geopandas.points_from_xy([row[1] for row in rows], [row[0] for row in rows]),
        crs="EPSG:4326",
    )
    write_table(root / "targets.parquet", frame, tables.TARGETS)


def one_step(root: Path, body: dict[str, Any]) -> dict[str, Any]:
    """One run of the process, timed from before its imports; what a worker does for a request."""
    began = time.perf_counter()
    from services.access.processes import PROCESSES
    from shared.artifacts.roots import Roots
    from shared.artifacts.store import ArtifactStore
    from shared.process.execution import resolve_step, run_step, validate_inputs

    store = ArtifactStore(Roots(str(root)))
    step = resolve_step(PROCESSES[0], validate_inputs(PROCESSES[0], body), store, "bench")
    outputs = run_step(step, store, "bench", "bench", lambda percent, message: None)
    seconds = time.perf_counter() - began
    report = json.loads(Path(outputs["report"]["href"].removeprefix("file://")).read_text())
    # of the worker processes only the largest is known: count it as often as there are workers
    workers = int(os.environ.get("SMOKEGLINT_FAN_OUT", "").partition(":")[2] or 0)
    own, child = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    peak_gb = (own + workers * child) * 1024 / 1e9
    return {"seconds": seconds, "peak_gb": peak_gb, "angle_deg": report["specular_angle_max_deg"], **report["counts"]}


def conus_day(root: Path) -> dict[str, Any]:
    """A day of seven CYGNSS and 31 GPS over the CONUS points, in this process."""
    names = {"receivers": "tle", "transmitters": "tle", "stations": "parquet", "targets": "parquet"}
    body = {name: {"href": f"{name}.{suffix}"} for name, suffix in names.items()}
    return one_step(root, body | {"start": "2020-07-31T00:00:00Z", "target_radius_km": 25.0})


def fresh(command: str, stage_files: Callable[[Path], None], **variables: str) -> dict[str, Any]:
    """A run in a fresh process."""
    with tempfile.TemporaryDirectory() as folder:
        stage_files(Path(folder))
        line = [sys.executable, "-m", "tests.bench.bench_access", command, folder]
        done = subprocess.run(line, check=True, capture_output=True, text=True, env={**os.environ, **variables})
    return dict(json.loads(done.stdout))


def fresh_conus_day(data: Path) -> dict[str, Any]:
    """The run in a fresh process; once before, so that compiled code is cached."""
    fresh("--conus-day", lambda root: stage(data, root))
    return fresh("--conus-day", lambda root: stage(data, root))


def fresh_global_day(data: Path, receivers: int = global_day.RECEIVERS) -> dict[str, Any]:
    """The global case over two worker processes."""

    def stage_files(root: Path) -> None:
        stage(data, root)
        global_day.stage(data, root, receivers)

    return fresh("--global-day", stage_files, SMOKEGLINT_FAN_OUT="processes:2")


def main() -> None:
    if sys.argv[1:2] == ["--conus-day"]:
        print(json.dumps(conus_day(Path(sys.argv[2]))))
        return
    if sys.argv[1:2] == ["--global-day"]:
        print(json.dumps(one_step(Path(sys.argv[2]), global_day.body())))
        return
    folder = os.environ.get("SMOKEGLINT_DATA")
    if not folder:
        print("SMOKEGLINT_DATA is not set: nothing to measure against", file=sys.stderr)
        return
    data = Path(folder)
    import numpy as np

    from tests.services.access.truth import (
        gmat_contact_differences_s,
        gmat_eclipse_differences_s,
        gps_sp3_distances_km,
    )

    day = fresh_conus_day(data)
    emit("conus_day_s", round(day["seconds"], 2))
    emit("conus_day_peak_gb", round(day["peak_gb"], 3))
    world = fresh_global_day(data)
    emit("global_day_s", round(world["seconds"], 1))
    emit("global_day_peak_gb", round(world["peak_gb"], 2))
    emit("specular_angle_max_deg", max(day["angle_deg"], world["angle_deg"]))
    if sys.argv[1:2] == ["--long"]:
        half = fresh_global_day(data, global_day.RECEIVERS // 2)
        emit("global_half_day_s", round(half["seconds"], 1))
    gmat = data / "events/gmat_cygfm01"
    emit("gmat_contact_max_dt_s", round(float(np.abs(gmat_contact_differences_s(gmat)).max()), 4))
    emit("gmat_eclipse_max_dt_s", round(float(np.abs(gmat_eclipse_differences_s(gmat)).max()), 4))
    distances = np.concatenate(list(gps_sp3_distances_km(data).values()))
    emit("gps_sp3_median_km", round(float(np.median(distances)), 3))


if __name__ == "__main__":
    main()
