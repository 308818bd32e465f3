"""Training of a burned-area model on an operator's own labelled looks, split by blocks of places."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from services.retrieval.burned_area import BurnedModel, auc, feature_table, train
from services.retrieval.labels import BURNED, UNKNOWN, label_looks, labels_from_grid
from shared.errors import DomainError

BLOCK_DEG = 1.0


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


def calibration_blocks(looks: pd.DataFrame, share: float) -> np.ndarray:
    """True for looks in the blocks of one degree that are held for calibration: a fixed hash of the block, (n,)."""
    row = np.floor(looks["latitude_deg"].to_numpy() / BLOCK_DEG).astype(np.int64)
    column = np.floor(looks["longitude_deg"].to_numpy() / BLOCK_DEG).astype(np.int64)
    return ((row * 73_856_093 + column * 19_349_663) % 997) / 997.0 < share


def train_on_looks(
    looks: pd.DataFrame, labels: pd.DataFrame, baseline: pd.DataFrame | None, calibration_share: float
) -> tuple[BurnedModel, dict[str, Any]]:
    """A model and its report; looks without a label near them are left out and counted."""
    label = label_looks(looks, labels)
    known = label != UNKNOWN
    kept, burned = looks[known].reset_index(drop=True), label[known] == BURNED
    table = feature_table(kept, baseline)
    held = calibration_blocks(kept, calibration_share)
    model = train(table, burned, held)
    score = auc(model.probability(table[held]), burned[held])
    return model, {
        "looks": len(kept),
        "burned": int(burned.sum()),
        "without_label": int((~known).sum()),
        "calibration_looks": int(held.sum()),
        "auc": None if np.isnan(score) else score,
        "threshold": model.threshold,
    }
