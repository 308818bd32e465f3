"""Real CYGNSS and SMAP over Texas (gnssr/texas_2024) as cell-days for the soil-moisture regression."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from services.retrieval.constants import BOLTZMANN_J_K
from services.retrieval.ease_grid import row_column
from services.retrieval.level1.reflectivity import reflectivity_db
from services.retrieval.looks.baseline import incidence_slope
from services.retrieval.soil_moisture.regression import match

NOISE_W = BOLTZMANN_J_K * 550.0 * 1000.0  # the file holds SNR, not power: power is taken as SNR times kTB
USABLE_PRN_MIN_GAIN_DBI = 3.0


def texas_looks(real_data: Path) -> pd.DataFrame:
    """Looks with reflectivity and 36 km EASE cells."""
    raw = pd.read_parquet(real_data / "gnssr/texas_2024/CYGNSS_Texas_202403_202409.parquet")
    raw = raw[raw["sp_rx_gain"] > USABLE_PRN_MIN_GAIN_DBI].reset_index(drop=True)
    power = NOISE_W * 10.0 ** (raw["ddm_snr"].to_numpy() / 10.0)
    eirp = 10.0 ** ((raw["gps_tx_power_db_w"] + raw["gps_ant_gain_db_i"]).to_numpy() / 10.0)
    ranges = raw["rx_to_sp_range"].to_numpy(float), raw["tx_to_sp_range"].to_numpy(float)
    row, column = row_column(raw["sp_lat"].to_numpy(), raw["sp_lon"].to_numpy(), 36)
    return pd.DataFrame(
        {
            "time": pd.to_datetime(raw["date"].astype(str)).to_numpy().astype("datetime64[ms]"),
            "row": row,
            "column": column,
            "reflectivity_db": reflectivity_db(power, eirp, raw["sp_rx_gain"].to_numpy(), *ranges),
            "incidence_deg": raw["sp_inc_angle"].to_numpy(),
        }
    )


def texas_soil_moisture(real_data: Path) -> pd.DataFrame:
    """SMAP 36 km soil moisture on EASE cells: time, row, column, soil_moisture."""
    tables = []
    for path in sorted((real_data / "gnssr/texas_2024").glob("SMAP_*/*.nc")):
        with xr.open_dataset(path) as file:
            latitude, longitude, moisture = (file[n].to_numpy().ravel() for n in smap_names(file))
        row, column = row_column(latitude, longitude, 36)
        day = np.datetime64(path.stem.rsplit("_", 1)[-1], "ms")
        tables.append(pd.DataFrame({"time": day, "row": row, "column": column, "soil_moisture": moisture}))
    table = pd.concat(tables, ignore_index=True)
    return table[table["soil_moisture"].between(0.02, 0.6)]


def smap_names(file: xr.Dataset) -> tuple[str, str, str]:
    """Names of latitude, longitude and soil moisture in a SMAP subset."""
    names = {name.lower(): name for name in map(str, file.variables)}
    pick = lambda *wanted: next(names[w] for w in wanted if w in names)  # noqa: E731
    return pick("latitude", "lat"), pick("longitude", "lon"), pick("soil_moisture", "sm", "soil_moisture_am")


def texas_pairs(real_data: Path) -> pd.DataFrame:
    """Cell-days that hold both."""
    looks = texas_looks(real_data)
    return match(looks, texas_soil_moisture(real_data), incidence_slope(looks))
