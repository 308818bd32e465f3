"""What was read, used and screened out and why, and the data volumes behind it: in every report and product."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
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
        "data_volume": data_volume(nominal, raw_if),
    }


def screening_note(attributes: Mapping[str, Any], width: int = 175) -> str:
    """The counts of a product's ``screening`` in words, for the foot of a picture; empty without."""
    said = []
    for name, counts in json.loads(attributes.get("screening", "{}")).items():
        first = ", ".join(f"{counts[key]} {key}" for key in ("read", "usable") if key in counts)
        rest = {key: count for key, count in counts.items() if key not in ("read", "usable")}
        ordered = sorted(rest.items(), key=lambda item: (-item[1], item[0]))
        said.append(f"{name}: " + "; ".join(filter(None, [first, ", ".join(f"{key} {n}" for key, n in ordered if n)])))
    return textwrap.fill(" · ".join(said), width)


def data_volume(nominal_seconds: int, raw_if_seconds: int) -> dict[str, int]:
    """Bytes on the downlink behind so many satellite-seconds of either mode."""
    return {
        "nominal_bytes": round(nominal_seconds * NOMINAL_BYTES_S),
        "raw_if_bytes": round(raw_if_seconds * RAW_IF_BYTES_S),
        "raw_if_to_nominal_per_second": RAW_IF_VOLUME_RATIO,
    }


def screening_attribute(counts: Mapping[str, Mapping[str, int]]) -> dict[str, str]:
    """Counts of what was read, used and left out as a product attribute: ``screening``, JSON by mode and reason.

    What a step leaves out after the screening of maps stands beside the modes, under a name of its own.
    """
    return {"screening": json.dumps(counts, sort_keys=True, separators=(",", ":"))}
