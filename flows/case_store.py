"""A case as the loop uses it: imported into the store, and calibrated on the days before its first cycle."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

from flows.cases.bundle import CASE_FILE, Case, read_case
from flows.loop_types import CaseInputs
from flows.runner import Runner
from flows.steps import IMPORT_CASE

CALIBRATION = "calibration"


def import_into_store(runner: Runner, case: Case) -> CaseInputs:
    """The case with references into the store instead of paths."""
    files = sorted({*case.inputs.values(), *case.nature.values()})
    bundle = {
        "case_file": {"href": (case.folder / CASE_FILE).as_uri()},
        "files": [{"href": path.as_uri()} for path in files],
    }
    made = runner.local(IMPORT_CASE, bundle)
    return CaseInputs(case.name, case.region, case.first_cutoff, made["inputs"], made["nature"])


def inputs_of_cycle(runner: Runner, case: Case, first: CaseInputs, number: int) -> CaseInputs:
    """What a cycle of a case with a bundle for each starts from, with the calibration of the ``first``."""
    own = import_into_store(runner, read_case(case.bundles[number - 1]))
    return replace(own, first_cutoff=case.first_cutoff, reference=first.reference, baseline=first.baseline)


def first_bundle(case: Case) -> Case:
    """The bundle that a case begins with."""
    return read_case(case.bundles[0]) if case.bundles else case


def calibrate(runner: Runner, case: CaseInputs, days: int, step_s: int, seed: int) -> CaseInputs:
    """Add the per-cell regression of soil moisture and the reflectivity baseline, from the days before the fires.

    The satellites watch the region in nominal mode all the time; ``step_s`` thins what is simulated of it.
    """
    start = case.first_cutoff - timedelta(days=days)
    tracks = runner.service(
        "access",
        "predict-access",
        {
            **{name: case.inputs[name] for name in ("receivers", "transmitters", "stations")},
            "start": start.isoformat(),
            "duration_s": days * 86400,
            "step_s": step_s,
            "area": list(case.region),
            "with_specular_points": True,
        },
    )
    history = runner.service(
        "retrieval",
        "simulate-observations",
        {
            "specular_points": tracks["specular_points"],
            "surface": case.nature["surface"],
            "seed": seed,
            "nominal": True,
            "raw_if": False,
        },
    )
    trained = runner.service(
        "retrieval",
        "train-soil-moisture",
        {"observations": [history["nominal"]], "soil_moisture": case.inputs["smap"]},
    )
    return replace(case, reference=trained["reference"], baseline=trained["baseline"])
