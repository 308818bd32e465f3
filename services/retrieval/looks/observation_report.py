"""What was read, used and screened out and why, and the data volumes behind it: in every report and product."""

from __future__ import annotations

import json
from typing import Any

from services.retrieval.constants import SAMPLING_HZ
from services.retrieval.looks.features import Observations

RAW_IF_CHANNELS, SAMPLES_PER_BYTE = 3, 4  # zenith, starboard, port
RAW_IF_BYTES_S = SAMPLING_HZ * RAW_IF_CHANNELS / SAMPLES_PER_BYTE  # 12.03 MB of a satellite-second
RAW_IF_VOLUME_RATIO = 1680  # of a raw-IF second to a nominal second on the downlink (CYGNSS)
NOMINAL_BYTES_S = RAW_IF_BYTES_S / RAW_IF_VOLUME_RATIO  # 7.2 kB: two samples of four compressed maps


def observation_report(observations: Observations) -> dict[str, Any]:
    """Maps read, used and screened out by reason, by mode; and the data volumes behind them."""
    looks = observations.looks
    used = {str(mode): int(count) for mode, count in looks["mode"].value_counts().sort_index().items()}
    whole = looks.assign(second=looks["time"].to_numpy().astype("datetime64[s]"))
    seconds = whole.drop_duplicates(["mode", "satellite", "second"])["mode"].value_counts()
    nominal, raw_if = (int(seconds.get(mode, 0)) for mode in ("nominal", "raw-if"))
    return {
        "screening": observations.screening,
        "looks_used": used,
        "nominal_seconds": nominal,
        "raw_if_seconds": raw_if,
        "raw_if_volume_in_nominal_seconds": raw_if * RAW_IF_VOLUME_RATIO,
        "data_volume": {
            "nominal_bytes": round(nominal * NOMINAL_BYTES_S),
            "raw_if_bytes": round(raw_if * RAW_IF_BYTES_S),
            "raw_if_to_nominal_per_second": RAW_IF_VOLUME_RATIO,
        },
    }


def screening_attribute(observations: Observations) -> dict[str, str]:
    """The counts of the screening as a product attribute: ``screening``, JSON by mode and reason."""
    return {"screening": json.dumps(observations.screening, sort_keys=True, separators=(",", ":"))}
