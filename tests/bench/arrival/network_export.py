"""The paper's network outside torch: equal as ONNX, its size, and the memory that one thread needs to run it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from services.arrival.exports.onnx_model import OPSET, largest_difference, onnx_bytes
from services.arrival.paper_method import PaperSettings, fit_paper
from tests.services.arrival.scored import case_of
from tests.services.arrival.seeds import BENCH
from tests.services.arrival.synthetic_fires import make_fire

Show = Callable[..., None]
# A fresh process, so that neither torch nor an earlier allocation hides what the session and its run take. A session of
# a model that does nothing comes first: what it takes is the runtime's, the rest the network's.
MEASURE = """
import gc, json, sys, time
import numpy, onnxruntime
def resident():
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096
def opened(path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = False
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
place, source = numpy.zeros((1, 2), numpy.float32), numpy.eye(4, dtype=numpy.float32)[:1]
start = resident()
idle = opened(sys.argv[2])
idle.run(None, {"x": place})
before = resident()
session = opened(sys.argv[1])
for _ in range(200):
    session.run(None, {"place_km": place, "source": source})
after = resident()
times = []
for _ in range(2000):
    began = time.perf_counter()
    session.run(None, {"place_km": place, "source": source})
    times.append(time.perf_counter() - began)
result = {"own": (after - before) / 1e6, "runtime": (before - start) / 1e6, "single_ms": 1e3 * sorted(times)[1000]}
print(json.dumps(result))
"""


def idle_model() -> bytes:
    """An ONNX model that gives back what it gets."""
    from onnx import TensorProto, helper

    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 2]) for name in "xy")
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "idle", [x], [y])
    return bytes(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8).SerializeToString()
    )


def network_export(show: Show) -> None:
    """Fit the paper's network briefly (its size does not depend on the training), export it and measure it."""
    case = case_of(make_fire(BENCH[0]))
    fitted = fit_paper(case.looks, PaperSettings(epochs=5), 0)
    model = onnx_bytes(fitted)
    rng = np.random.default_rng(0)
    place = rng.uniform(-15, 15, (10_000, 2)).astype(np.float32)
    source = np.eye(4, dtype=np.float32)[rng.integers(0, 4, 10_000)]
    hours, probability = largest_difference(model, fitted, place, source)
    show("nn_onnx_difference_h", hours, "h", 1e-3)
    show("nn_onnx_difference_probability", probability, "1", 1e-5)
    show("nn_onnx_mb", len(model) / 1e6, "MB", 0.08)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        idle = Path(folder) / "idle.onnx"
        path.write_bytes(model)
        idle.write_bytes(idle_model())
        single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        ran = subprocess.run(
            [sys.executable, "-c", MEASURE, str(path), str(idle)],
            capture_output=True,
            check=True,
            env={**os.environ, **single},
        )
    measured = json.loads(ran.stdout)
    show("nn_onnx_memory_mb", measured["own"], "MB", 3.39)
    show("nn_onnx_runtime_memory_mb", measured["runtime"], "MB")
    show("nn_onnx_single_ms", measured["single_ms"], "ms", 0.17)
