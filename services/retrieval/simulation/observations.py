"""From specular points and a surface to level-1 files: the satellites at work, in simulation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from services.retrieval.level1.writer import COUNTS_OF_NOISE, MapLayout, write_level1
from services.retrieval.simulation.ambiguity import NOMINAL, RAW_IF, MapGrid
from services.retrieval.simulation.coherency import coherency_ratio
from services.retrieval.simulation.footprint import Strength, strengths, track_bearing_deg
from services.retrieval.simulation.looks import looks_table, nominal_looks, raw_if_looks
from services.retrieval.simulation.maps import LOOK_S, NOISE_FLOOR_W, Link, simulate_maps
from services.retrieval.simulation.surface import Surface

EIRP_RANGE_DBW = (26.5, 31.5)  # over the GPS constellation
EIRP_ERROR_DB = 0.3  # between the true power and the one that level-1 reports
LAND_FLAGS = 7169  # poor_overall_quality (set on all land), over_land, very_near_land, near_land: as in real files
STREAMS = {NOMINAL.mode: 1, RAW_IF.mode: 2}


@dataclass(frozen=True)
class Simulated:
    """What was simulated of one mode: the looks with their truth, the maps; how many specular points were given, how
    many of them are no GPS ones, how many were not observed in this mode, how many looks had no surface.
    """

    looks: pd.DataFrame
    maps: NDArray[np.float32]
    grid: MapGrid
    given: int
    not_gps: int
    not_observed: int
    without_surface: int

    def write(self, path: str | Path, attributes: Mapping[str, Any]) -> None:
        """Write the level-1 file; the truth columns stay behind."""
        grid = self.grid
        steps = grid.delay_resolution_chips, grid.doppler_resolution_hz
        layout = MapLayout(grid.mode, grid.delays, grid.dopplers, *steps)
        counts = json.dumps({grid.mode: self.counts()}, sort_keys=True, separators=(",", ":"))
        title = f"Simulated CYGNSS level-1 delay-Doppler maps, {grid.mode}"
        marked = {"title": title, "screening": counts, **attributes, "simulated": True}
        looks = self.looks.assign(coherency_ratio=coherency_ratio(self.maps, grid))
        write_level1(path, looks, self.maps, layout, NOISE_FLOOR_W, marked)

    def counts(self) -> dict[str, int]:
        """Specular points given, those that became maps, and why the others did not."""
        left_out = {name: getattr(self, name) for name in ("not_gps", "not_observed", "without_surface")}
        return {"read": self.given, "usable": len(self.looks), **left_out}

    def satellite_seconds(self) -> int:
        """Seconds of a satellite that the maps are of: what has to be downlinked."""
        return len(self.looks.assign(second=self.looks["time_ms"] // 1000).drop_duplicates(["satellite", "second"]))

    def summary(self) -> dict[str, Any]:
        """Counts for the report, the truth about burned ground left out."""
        looks = self.looks
        return {
            "maps": len(looks),
            "satellites": sorted(looks["satellite"].unique().tolist()),
            "without_surface": self.without_surface,
            "screening": self.counts(),
            "shape": [self.grid.delays, self.grid.dopplers],
        }


def simulate_nominal(specular_points: pd.DataFrame, surface: Surface, seed: int) -> Simulated:
    """17 x 11 maps of the looks that the on-board tracker follows."""
    looks = _prepared(specular_points)
    return _simulate(nominal_looks(looks), surface, NOMINAL, seed, (len(specular_points), len(looks)))


def simulate_raw_if(specular_points: pd.DataFrame, images: pd.DataFrame, surface: Surface, seed: int) -> Simulated:
    """69 x 111 maps of every look in the antenna beams during the collected seconds of an as_run table."""
    looks = _prepared(specular_points)
    return _simulate(raw_if_looks(looks, images), surface, RAW_IF, seed, (len(specular_points), len(looks)))


def _prepared(specular_points: pd.DataFrame) -> pd.DataFrame:
    looks = looks_table(specular_points)
    track = looks["track"].to_numpy()
    position = (looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy())
    return looks.assign(bearing_deg=track_bearing_deg(track, *position, looks["time_ms"].to_numpy() / 1000.0))


def _simulate(
    looks: pd.DataFrame, surface: Surface, grid: MapGrid, seed: int, given_and_gps: tuple[int, int]
) -> Simulated:
    given, gps = given_and_gps
    not_observed = gps - len(looks)
    times = looks["time_ms"].to_numpy().astype("datetime64[ms]")
    known = surface.covers(looks["latitude_deg"].to_numpy(), looks["longitude_deg"].to_numpy(), times)
    looks = looks[known].reset_index(drop=True)
    looks["sample"] = np.unique(looks["sample"], return_inverse=True)[1]
    rng = np.random.default_rng([seed, STREAMS[grid.mode]])
    strength = _strength(looks, surface, LOOK_S[grid.mode])
    eirp_w = 10.0 ** (_eirp_dbw(looks["transmitter"]) / 10.0)
    error_db = rng.normal(0.0, EIRP_ERROR_DB, len(looks))
    maps = simulate_maps(_link(looks, eirp_w), strength, grid, rng)
    looks = looks.assign(
        burned_share=strength.burned_share,
        coherent_db=10.0 * np.log10(strength.coherent),
        reported_eirp_w=eirp_w * 10.0 ** (error_db / 10.0),
        water_pct=100.0 * strength.water_share,
        **_level1_columns(looks, maps, grid),
    )
    return Simulated(looks, maps, grid, given, given - gps, not_observed, int((~known).sum()))


def _strength(looks: pd.DataFrame, surface: Surface, look_s: float) -> Strength:
    return strengths(
        surface,
        looks["latitude_deg"].to_numpy(),
        looks["longitude_deg"].to_numpy(),
        looks["time_ms"].to_numpy().astype("datetime64[ms]"),
        looks["incidence_deg"].to_numpy(),
        looks["bearing_deg"].to_numpy(),
        look_s,
    )


def _link(looks: pd.DataFrame, eirp_w: NDArray[np.float64]) -> Link:
    track = looks["track"].to_numpy()
    heading = (looks["bearing_deg"].to_numpy() + 67.0 * track) % 180.0  # plane of incidence: fixed to the track
    columns = (looks[n].to_numpy() for n in ("rx_gain_dbi", "rx_range_m", "tx_range_m", "incidence_deg"))
    return Link(eirp_w, *columns, heading_deg=heading)


def _eirp_dbw(transmitter: pd.Series) -> NDArray[np.float64]:
    """Each transmitter's EIRP: a fixed place in the range of the constellation."""
    names, index = np.unique(transmitter.to_numpy(dtype=str), return_inverse=True)
    share = np.array([(sum(ord(c) * 31**i for i, c in enumerate(name)) * 0.6180339887) % 1.0 for name in names])
    return (EIRP_RANGE_DBW[0] + (EIRP_RANGE_DBW[1] - EIRP_RANGE_DBW[0]) * share)[index]


def _level1_columns(looks: pd.DataFrame, maps: NDArray[np.float32], grid: MapGrid) -> dict[str, Any]:
    count = len(looks)
    peak = maps.reshape(count, -1).max(axis=1).astype(np.float64) if count else np.empty(0)
    return {
        "longitude_east_deg": looks["longitude_deg"].to_numpy() % 360.0,
        "snr_db": 10.0 * np.log10(np.maximum(peak, 1e-21) / NOISE_FLOOR_W),
        "noise_counts": np.full(count, COUNTS_OF_NOISE),
        "specular_row": np.full(count, float(grid.delays // 2)),
        "specular_column": np.full(count, float(grid.dopplers // 2)),
        "prn": looks["transmitter"].str.slice(1).astype(int).to_numpy(),
        "spacecraft": looks["satellite"].str.extract(r"(\d+)$")[0].astype(int).to_numpy(),
        "quality_flags": np.full(count, LAND_FLAGS),
        "quality_flags_2": np.zeros(count),
        "land_valid": np.ones(count),
        "land_confidence": np.full(count, 3),
    }
