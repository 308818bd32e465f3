"""A SIMULATED fire history, from a stated truth and a seed: what the demonstration coefficients are refitted to.

No public table gives WFPI on days and places without a fire, so there is nothing real to fit WLFP to here. The truth is
chosen so that its forecasts span the USGS's published bins (WFSP 0.2 to over 30 %, WLFP 0.04 to over 7 per million
km2-days); ``python -m services.prioritization.prefire.fire_history FOLDER`` writes the two tables of a refit.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from services.prioritization.prefire import fire_probability

Array = npt.NDArray[np.float64]

YEARS = range(2001, 2016)
WEST, EAST, SOUTH, NORTH = -124.0, -68.0, 26.0, 49.0
AREA_KM2 = 400_000.0  # a twentieth of the conterminous United States, spread over all of it
BACKGROUND = 60_000
CANDIDATES = 700_000  # of which the truth's rate lights some
SOURCE = "simulated fire history 2001-2015, seed 0"


def truth(longitude_deg: Array, latitude_deg: Array, day_of_year: Array, wfpi: Array) -> tuple[Array, Array]:
    """The logit of spread beyond 500 acres, and ignitions per km2 and day."""
    season = np.cos(2 * np.pi * (day_of_year - 210) / 365.25)
    west = np.tanh((-100 - longitude_deg) / 8)
    spread = -6.3 + 0.036 * wfpi + 0.4 * season + 0.5 * west
    southeast = np.exp(-(((longitude_deg + 84) / 9) ** 2) - ((latitude_deg - 33) / 5) ** 2)
    ignitions = 2.0e-5 * np.exp(0.012 * (wfpi - 50) + 0.4 * season + 0.8 * southeast)
    return spread, ignitions


def _voxels(rng: np.random.Generator, count: int) -> pd.DataFrame:
    """Places and days at random, with a WFPI that has a season, a gradient, wet and dry years, and weather."""
    longitude = rng.uniform(WEST, EAST, count)
    sine = rng.uniform(np.sin(np.radians(SOUTH)), np.sin(np.radians(NORTH)), count)
    latitude = np.degrees(np.arcsin(sine))
    first, days = pd.Timestamp(f"{YEARS[0]}-01-01", tz="UTC"), 365.25 * len(YEARS)
    time = first + pd.to_timedelta(np.floor(rng.uniform(0, days - 1, count)), unit="D")
    year_effect = rng.normal(0, 5, len(YEARS))[np.clip(time.year.to_numpy() - YEARS[0], 0, len(YEARS) - 1)]
    west = np.tanh((-100 - longitude) / 8)
    season = np.cos(2 * np.pi * (time.dayofyear.to_numpy() - 205) / 365.25)
    mean = 42 + 22 * season * (0.6 + 0.4 * west) + 10 * west + year_effect
    wfpi = np.clip(mean + rng.gamma(4.0, 9.0, count) - 36, 0, 160)
    return pd.DataFrame({"longitude_deg": longitude, "latitude_deg": latitude, "time": time, "wfpi": wfpi})


def simulate(seed: int = 0) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Fires and voxels, as the refit wants them; the voxels say of each ignition whether it grew ``large``."""
    rng = np.random.default_rng(seed)
    total = AREA_KM2 * 365.25 * len(YEARS)
    background = _voxels(rng, BACKGROUND).assign(ignition=0, sampling_rate=BACKGROUND / total, large=0)
    candidates = _voxels(rng, CANDIDATES)
    _, rate = _truth_of(candidates)
    ceiling = total / len(candidates)
    lit = candidates[rng.uniform(size=len(candidates)) < np.minimum(rate * ceiling, 1.0)].reset_index(drop=True)
    spread, _ = _truth_of(lit)
    grew = rng.uniform(size=len(lit)) < fire_probability.sigmoid(spread)
    lit = lit.assign(ignition=1, sampling_rate=1.0, large=grew.astype(int))
    fires = lit[["longitude_deg", "latitude_deg", "time", "wfpi", "large"]]
    return fires, pd.concat([lit, background], ignore_index=True)


def _truth_of(table: pd.DataFrame) -> tuple[Any, Any]:
    longitude, latitude = table["longitude_deg"].to_numpy(), table["latitude_deg"].to_numpy()
    return truth(longitude, latitude, table["time"].dt.dayofyear.to_numpy(), table["wfpi"].to_numpy())


def main() -> None:
    """Write fires.parquet and voxels.parquet into the folder named."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    fires, voxels = simulate()
    fires.to_parquet(folder / "fires.parquet")
    voxels.to_parquet(folder / "voxels.parquet")


if __name__ == "__main__":
    main()
