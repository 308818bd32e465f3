"""A delay-Doppler map computed from a recording, as a level-1 file of one sample, and its report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from services.retrieval.constants import BOLTZMANN_J_K, CODE_RATE_HZ, FILL
from services.retrieval.level1.writer import COUNTS_OF_NOISE, MapLayout, write_level1
from services.retrieval.looks.observation_report import NOMINAL_BYTES_S
from services.retrieval.raw_if.acquisition import DELAYS, DOPPLER_STEP_HZ, DOPPLERS, DelayDopplerMap
from services.retrieval.raw_if.recording import HEADER, Header, Recording
from shared.errors import DomainError

GPS_EPOCH_MS = int(np.datetime64("1980-01-06", "ms").astype(np.int64))
LEAP_SECONDS = 18  # GPS - UTC since 2017-01-01 (IERS Bulletin C); CYGNSS raw-IF recordings are all later
WEEK_MS = 7 * 86_400_000
COHERENT_BANDWIDTH_HZ = 1000.0
GEOMETRY = {
    "latitude_deg": FILL,
    "longitude_deg": FILL,
    "incidence_deg": FILL,
    "rx_gain_dbi": FILL,
    "rx_range_m": -99999999.0,
    "tx_range_m": -99999999.0,
    "eirp_w": FILL,
}


def write_ddm(
    path: Path,
    found: DelayDopplerMap,
    header: Header,
    prn: int,
    look: Mapping[str, float],
    noise_temperature_k: float,
    attributes: Mapping[str, Any],
) -> None:
    """Write the map; power in W is the noise-relative power times k T B, for a recording carries no calibration.

    ``look`` gives the geometry where known (keys of GEOMETRY); what is unknown is fill, and screened out by the
    retrieval.
    """
    unknown = sorted(set(look) - set(GEOMETRY))
    if unknown:
        raise DomainError(f"Unknown look entries {unknown}.", field="look", value=unknown, accepted=", ".join(GEOMETRY))
    noise_w = BOLTZMANN_J_K * noise_temperature_k * COHERENT_BANDWIDTH_HZ
    layout = MapLayout("raw-if", DELAYS, DOPPLERS, CODE_RATE_HZ / header.sampling_hz, DOPPLER_STEP_HZ)
    row = _row(found, header, prn, {**GEOMETRY, **look})
    maps = (found.power[None] * noise_w).astype(np.float32)
    title = {"title": "Delay-Doppler map from a raw-IF recording", "power_calibration": "noise floor taken as k T B"}
    write_level1(path, row, maps, layout, noise_w, {**title, **attributes})


def _row(found: DelayDopplerMap, header: Header, prn: int, look: Mapping[str, float]) -> pd.DataFrame:
    peak = float(found.power.max())
    longitude = look["longitude_deg"]
    start_ms = GPS_EPOCH_MS + header.gps_week * WEEK_MS + (header.gps_second - LEAP_SECONDS) * 1000
    values = {
        "sample": 0,
        "ddm": 0,
        "time_ms": start_ms,
        "spacecraft": 0,
        "latitude_deg": look["latitude_deg"],
        "longitude_east_deg": longitude if longitude == FILL else longitude % 360.0,
        "incidence_deg": look["incidence_deg"],
        "rx_gain_dbi": look["rx_gain_dbi"],
        "reported_eirp_w": look["eirp_w"],
        "rx_range_m": look["rx_range_m"],
        "tx_range_m": look["tx_range_m"],
        "snr_db": 10.0 * np.log10(max(peak, 1e-3)),
        "noise_counts": COUNTS_OF_NOISE,
        "coherency_ratio": FILL,
        "water_pct": FILL,
        "specular_row": FILL,
        "specular_column": FILL,
        "prn": prn,
        "quality_flags": 0,
        "quality_flags_2": 0,
        "land_valid": -99999999,
        "land_confidence": -99999999,
    }
    return pd.DataFrame([values])


def milliseconds(found: DelayDopplerMap) -> dict[str, int]:
    """Milliseconds read, used and left out, in the words of the screening of maps."""
    used, lost = found.milliseconds, found.milliseconds_lost
    return {"read_ms": used + lost, "usable_ms": used, "lost_packets_ms": lost}


def report(found: DelayDopplerMap, recording: Recording, product_bytes: int) -> dict[str, Any]:
    """What was found, how much of the recording was lost, and the data volumes before and after."""
    nominal = NOMINAL_BYTES_S * recording.duration_s
    return {
        "code_phase_chips": found.acquired.code_phase_chips,
        "doppler_hz": found.acquired.doppler_hz,
        "peak_to_mean": found.acquired.peak_to_mean,
        "peak_snr_db": 10.0 * float(np.log10(max(found.power.max(), 1e-3))),
        "milliseconds_used": found.milliseconds,
        "milliseconds_lost": found.milliseconds_lost,
        "recording_s": recording.duration_s,
        "channels": recording.header.channels,
        "data_volume": {
            "raw_if_bytes": int(recording.data.size) + HEADER.size,
            "ddm_bytes": product_bytes,
            "nominal_bytes_of_the_time": round(nominal),
            "raw_if_to_nominal": round(recording.data.size / nominal),
        },
    }
