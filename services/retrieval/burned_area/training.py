"""Training of a burned-area model on looks of known fate, split by places and, where it can be, by time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from services.retrieval.ancillary.burned_rasters import BurnedRaster, label_by_rasters
from services.retrieval.ancillary.layers import ANCILLARY_FEATURES
from services.retrieval.burned_area.labels import BURNED, UNBURNED, UNKNOWN, label_looks, labels_from_grid
from services.retrieval.burned_area.model import FEATURES, BurnedModel, auc, feature_table, train
from shared.errors import DomainError

BLOCK_DEG = 1.0
ENOUGH = 20  # looks, with both classes, on either side of a split
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Split:
    """Looks to train on and looks held for calibration and scores; the rest is left out. ``kind`` says by what."""

    training: Mask
    held: Mask
    kind: str


def read_labels(path: Path) -> pd.DataFrame:
    """Labels from Parquet (longitude_deg, latitude_deg, burn_time) or from a netCDF grid with burn_time."""
    with open(path, "rb") as file:
        parquet = file.read(4) == b"PAR1"
    if not parquet:
        return labels_from_grid(str(path))
    try:
        return pd.read_parquet(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise DomainError(f"The labels cannot be read as Parquet: {error}", field="labels") from error


def union_labels(looks: pd.DataFrame, places: pd.DataFrame | None, rasters: Sequence[BurnedRaster]) -> NDArray[np.int8]:
    """BURNED where places or rasters say so, else UNBURNED where either does, else UNKNOWN, (n,)."""
    if places is None and not rasters:
        raise DomainError("There are no labels.", field="labels", accepted="labels, burned_rasters, or both")
    said = [label_looks(looks, places)] if places is not None else []
    if rasters:
        said.append(label_by_rasters(looks, rasters))
    burned = np.logical_or.reduce([label == BURNED for label in said])
    unburned = np.logical_or.reduce([label == UNBURNED for label in said])
    return np.where(burned, BURNED, np.where(unburned, UNBURNED, UNKNOWN)).astype(np.int8)


def calibration_blocks(looks: pd.DataFrame, share: float) -> Mask:
    """True for looks in the blocks of one degree that are held for calibration: a fixed hash of the block, (n,)."""
    row = np.floor(looks["latitude_deg"].to_numpy() / BLOCK_DEG).astype(np.int64)
    column = np.floor(looks["longitude_deg"].to_numpy() / BLOCK_DEG).astype(np.int64)
    return ((row * 73_856_093 + column * 19_349_663) % 997) / 997.0 < share


def split_looks(looks: pd.DataFrame, burned: Mask, share: float) -> Split:
    """Held looks lie in blocks of their own and, where enough of both classes remain, later than all training looks.

    Tried at days in the middle of the looks' time, the most even one first; one fire has no later season, and is split
    by place alone.
    """
    elsewhere = calibration_blocks(looks, share)
    day = looks["time"].to_numpy().astype("datetime64[D]")
    order = sorted((abs(q - 0.5), q) for q in np.arange(3, 8) / 10)
    for cut in (np.sort(day)[int(q * (len(day) - 1))] for _, q in order if len(day)):
        training, held = ~elsewhere & (day < cut), elsewhere & (day >= cut)
        if all(_enough(burned[part]) for part in (training, held)):
            return Split(training, held, "region and time")
    return Split(~elsewhere, elsewhere, "region")


def _enough(burned: Mask) -> bool:
    return burned.size >= 10 * ENOUGH and ENOUGH <= int(burned.sum()) <= burned.size - ENOUGH


def train_on_looks(
    looks: pd.DataFrame, label: NDArray[np.int8], baseline: pd.DataFrame | None, calibration_share: float
) -> tuple[BurnedModel, dict[str, Any]]:
    """A model and its report; looks of UNKNOWN label are left out and counted.

    Ancillary features are learnt from only where they are known of some look.
    """
    known = label != UNKNOWN
    kept, burned = looks[known].reset_index(drop=True), label[known] == BURNED
    table = feature_table(kept, baseline)
    features = FEATURES + tuple(name for name in ANCILLARY_FEATURES if table[name].notna().any())
    split = split_looks(kept, burned, calibration_share)
    used = split.training | split.held
    model = train(table[used], burned[used], split.held[used], features)
    score = auc(model.probability(table[split.held]), burned[split.held])
    return model, {
        "looks": len(kept),
        "burned": int(burned.sum()),
        "without_label": int((~known).sum()),
        "split": split.kind,
        "training_looks": int(split.training.sum()),
        "calibration_looks": int(split.held.sum()),
        "features": list(features),
        "auc": None if np.isnan(score) else score,
        "threshold": model.threshold,
    }
