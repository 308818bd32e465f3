"""A fitted network as ONNX: coordinates in, arrival and burned probability out, checked to give what torch gives."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from services.arrival.network import SOURCE_COUNT, PaperNetwork
from shared.errors import SmokeglintError

OPSET = 17
Floats = NDArray[np.float32]


class PaperLike(Protocol):
    """What the export needs of a fitted network of the paper: the network, its scaling and the shift of its times."""

    network: PaperNetwork
    low_km: NDArray[np.float64]
    high_km: NDArray[np.float64]
    low_h: float
    high_h: float
    shift_h: float


class PlainPaper(nn.Module):
    """The paper's network with its scaling: local km (n, 2) and source id as one-hot (n, sources) in, hours since the
    reference time and fire probability (n,) out."""

    def __init__(self, fitted: PaperLike) -> None:
        super().__init__()
        self.network = fitted.network.eval()
        self.register_buffer("low", torch.tensor(fitted.low_km, dtype=torch.float32))
        self.register_buffer("span", torch.tensor(fitted.high_km - fitted.low_km, dtype=torch.float32))
        self.first_h, self.span_h, self.shift_h = fitted.low_h, fitted.high_h - fitted.low_h, fitted.shift_h

    def forward(self, place_km: Tensor, source: Tensor) -> tuple[Tensor, Tensor]:
        scaled = 2 * (place_km - self.low) / self.span - 1
        arrival, logit = self.network(torch.cat([scaled, source], dim=1))
        return self.first_h + self.span_h * (arrival + 1) / 2 + self.shift_h, torch.sigmoid(logit)


def example_inputs(count: int = 3) -> tuple[Tensor, Tensor]:
    """Inputs of the right shapes: places around the grid's centre and the first source."""
    place = torch.linspace(-5.0, 5.0, 2 * count).reshape(count, 2)
    return place, nn.functional.one_hot(torch.zeros(count, dtype=torch.long), SOURCE_COUNT).float()


def onnx_bytes(fitted: PaperLike) -> bytes:
    """The fitted network of the paper as an ONNX model (opset 17) of any number of samples; same network, same bytes.

    Inputs `place_km` (n, 2) and `source` (n, 4) one-hot of viirs, modis, other, gnss-r; outputs `arrival_h` and
    `fire_probability` (n,).
    """
    held = io.BytesIO()
    axes: Mapping[str, Any] = {name: {0: "n"} for name in ("place_km", "source", "arrival_h", "fire_probability")}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that needs no further package is called old
        torch.onnx.export(
            PlainPaper(fitted),
            example_inputs(),
            held,
            dynamo=False,
            opset_version=OPSET,
            input_names=["place_km", "source"],
            output_names=["arrival_h", "fire_probability"],
            dynamic_axes=dict(axes),
        )
    return held.getvalue()


def session(model: bytes | Path) -> Any:
    """An onnxruntime session on one thread."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    held = str(model) if isinstance(model, Path) else model
    return onnxruntime.InferenceSession(held, options, providers=["CPUExecutionProvider"])


def largest_difference(model: bytes, fitted: PaperLike, place_km: Floats, source: Floats) -> tuple[float, float]:
    """(hours, probability) by which the ONNX model and the network differ at most over samples (n, 2) and (n, 4)."""
    theirs = session(model).run(None, {"place_km": place_km, "source": source})
    with torch.no_grad():
        ours = PlainPaper(fitted)(torch.tensor(place_km), torch.tensor(source))
    return tuple(float(np.abs(a - b.numpy()).max()) for a, b in zip(theirs, ours, strict=True))  # type: ignore[return-value]


def export_network(path: Path, fitted: PaperLike, tolerance_h: float = 1e-3) -> None:
    """Write the network as ONNX after checking it equal to torch over the fire's extent.

    Raises SmokeglintError, and writes nothing, where the two differ by more than `tolerance_h` hours or 1e-5 in
    probability.
    """
    model = onnx_bytes(fitted)
    share = np.linspace(0, 1, 500, dtype=np.float32)
    place = (fitted.low_km + (fitted.high_km - fitted.low_km) * np.column_stack([share, share[::-1]])).astype(
        np.float32
    )
    source = np.eye(SOURCE_COUNT, dtype=np.float32)[np.arange(share.size) % SOURCE_COUNT]
    hours, probability = largest_difference(model, fitted, place, source)
    if hours > tolerance_h or probability > 1e-5:
        raise SmokeglintError(f"the ONNX model differs from the network by {hours:.2g} h and {probability:.2g}")
    path.write_bytes(model)
