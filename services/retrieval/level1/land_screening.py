"""Screening of level-1 samples over land by named quality flags, with counts of what was left out and why.

Bit 0 of ``quality_flags`` (poor_overall_quality) is an ocean verdict, set on every land sample; it is never used.
Bits and limits follow the CYGNSS v3.2 data dictionary (148-0346) and the land practice of GEOS-LDAS and cygnsslib.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

FLAGS_1 = {
    "s_band_powered_up": 1,
    "large_sc_attitude_err": 3,
    "black_body_ddm": 4,
    "ddmi_reconfigured": 5,
    "spacewire_crc_invalid": 6,
    "ddm_is_test_pattern": 7,
    "channel_idle": 8,
    "large_step_lna_temp": 14,
    "direct_signal_in_ddm": 15,
    "low_confidence_gps_eirp_estimate": 16,
    "rfi_detected": 17,
    "gps_pvt_sp3_error": 21,
    "sp_non_existent_error": 22,
    "ant_data_lut_range_error": 24,
    "bb_framing_error": 25,
    "fsw_comp_shift_error": 26,
    "sc_altitude_out_of_nominal_range": 28,
    "anomalous_sampling_period": 29,
    "invalid_roll_state": 30,
}
FLAGS_2 = {
    "incorrect_ddmi_antenna_selection": 0,
    "high_signal_noise": 1,
    "noise_floor_cal_error": 2,
    "land_poor_overall_quality": 11,
    "over_ocean": 12,
    "land_sp_range_error": 15,
}


@dataclass(frozen=True)
class LandLimits:
    """Accepted ranges: incidence (deg), receive gain (dBi), SNR (dB), land confidence, open water (%)."""

    max_incidence_deg: float = 65.0
    min_rx_gain_dbi: float = 0.0
    min_snr_db: float = 1.0
    min_land_confidence: float = 2.0
    max_water_pct: float = 10.0


def screen_land(
    metadata: pd.DataFrame, peak_w: NDArray, limits: LandLimits
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Mask of usable maps (n,) and the number of maps that each reason rules out (a map may have several reasons).

    Absent optional variables (NaN) rule nothing out; fill in a required one does.
    """
    reasons = {
        "all_fill": metadata["all_fill"].to_numpy(),
        "part_fill": metadata["part_fill"].to_numpy(),
        "no_time": metadata["time"].isna().to_numpy(),
        "missing_metadata": _missing(metadata),
        "peak_not_positive": ~(peak_w > 0),
        "unknown_prn": ~metadata["prn_code"].between(1, 32).to_numpy(),
        "incidence_too_high": (metadata["sp_inc_angle"] > limits.max_incidence_deg).to_numpy(),
        "rx_gain_too_low": (metadata["sp_rx_gain"] <= limits.min_rx_gain_dbi).to_numpy(),
        "snr_too_low": (metadata["ddm_snr"] < limits.min_snr_db).to_numpy(),
        "not_land": (metadata["sp_land_valid"] == 0).to_numpy(),
        "land_confidence_too_low": (metadata["sp_land_confidence"] < limits.min_land_confidence).to_numpy(),
        "open_water": (metadata["pekel_sp_water_percentage_5km"] > limits.max_water_pct).to_numpy(),
        **_flagged(metadata["quality_flags"], FLAGS_1),
        **_flagged(metadata["quality_flags_2"], FLAGS_2),
    }
    empty = reasons["all_fill"]
    usable = ~np.logical_or.reduce(list(reasons.values()))
    counts = {name: int((hit & ~empty).sum()) for name, hit in reasons.items() if name != "all_fill"}
    return usable, {"all_fill": int(empty.sum()), **{name: count for name, count in counts.items() if count}}


def _missing(metadata: pd.DataFrame) -> NDArray[np.bool_]:
    needed = ["sp_lat", "sp_lon", "sp_inc_angle", "sp_rx_gain", "gps_eirp", "rx_to_sp_range", "tx_to_sp_range"]
    values = metadata[needed].to_numpy(dtype=np.float64)
    finite = np.isfinite(values).all(axis=1) & metadata["quality_flags"].notna().to_numpy()
    inside = (np.abs(values[:, 0]) <= 90) & (values[:, 1] >= -180) & (values[:, 1] <= 360)
    positive = (values[:, 4:] > 0).all(axis=1)
    return ~(finite & inside & positive)


def _flagged(flags: pd.Series, bits: dict[str, int]) -> dict[str, NDArray[np.bool_]]:
    numbers = np.nan_to_num(flags.to_numpy(dtype=np.float64)).astype(np.int64)
    return {name: (numbers >> bit) & 1 == 1 for name, bit in bits.items()}
