"""WFSP refitted to real fires: ``python -m tests.bench.prioritization.wfsp_us_fires`` prints its reliability as JSON.

US fires of ICS-209 with gridMET weather within three days of ignition and greenness of the same month of 2001; over 500
acres is large. ICS-209 leaves out most small fires, so the base rate is some ten times that of all ignitions: a test of
the refit on real fires, not a WFSP to use.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd

from services.prioritization import indices
from services.prioritization.prefire import (
    fire_potential,
    fire_probability_fit,
    fire_probability_skill,
    fuels,
    vegetation_2001,
)
from services.prioritization.prefire.danger_grid import GeographicGrid

ACRE_KM2 = 0.00404685642
DAYS = 3


def fires_with_wfpi(folder: Path) -> pd.DataFrame:
    """One row a fire: its day nearest to ignition, WFPI from that day's weather and the month's greenness."""
    table = pd.read_csv(folder / "large_fire" / "us_gridmet_ics209.csv")
    table = table[table["days_from_ignition"] <= DAYS].sort_values("days_from_ignition", kind="stable")
    table = table.drop_duplicates("ics_id").reset_index(drop=True)
    when = pd.to_datetime(table["datetime"], utc=True)
    hottest, driest = table["tmmx"] - 273.15, table["rmin"]
    moisture = indices.fuel_moisture_10h_pct(hottest.to_numpy(), driest.to_numpy())
    factor = fire_potential.WeatherTerms().factor(table["vs"].to_numpy(), hottest.to_numpy(), table["pr"].to_numpy())
    fpi = np.full(len(table), np.nan)
    for month in range(1, 13):
        rows = np.flatnonzero(when.dt.month == month)
        given = fuels.fuels_from_dataset(vegetation_2001.fuels(folder / "vegetation", month))
        assert isinstance(given.grid, GeographicGrid)
        places = table.iloc[rows]
        y = np.abs(given.grid.latitude_deg[:, None] - places["latitude"].to_numpy()).argmin(axis=0)
        x = np.abs(given.grid.longitude_deg[:, None] - places["longitude"].to_numpy()).argmin(axis=0)
        share = fire_potential.live_ratio(given.greenness[y, x], given.ndvi_max[y, x], given.ndvi_largest)
        fpi[rows] = fire_potential.fpi_2000(share, moisture[rows], given.extinction_pct[y, x])
    places = {"longitude_deg": table["longitude"], "latitude_deg": table["latitude"], "time": when}
    frame = pd.DataFrame(
        {**places, "wfpi": fire_potential.wfpi(fpi, factor), "area_km2": table["ics_acres"] * ACRE_KM2}
    )
    return fire_probability_fit.checked_fires(frame.dropna())


def main() -> None:
    """Refit, predict each year from the others, and print every bin and the summary."""
    fires = fires_with_wfpi(Path(os.environ["SMOKEGLINT_DATA"]))
    large = fires["large"].to_numpy()
    model, penalty = fire_probability_fit.fit_logit(
        fires, "large", fire_probability_fit.box_of(fires), (3.0, 30.0, 300.0)
    )
    predicted = fire_probability_skill.left_out_predictions(fires, "large", model, penalty)
    bins = fire_probability_skill.WFSP_BINS
    rows = fire_probability_skill.reliability(predicted, large.astype(float), np.ones(len(fires)), bins, 100.0)
    for row in rows:
        if row["rows"]:
            print(json.dumps({name: round(value, 2) for name, value in row.items()}))
    order = predicted[large == 1][:, None] - predicted[large == 0][None, :]
    auc = float((order > 0).mean() + 0.5 * (order == 0).mean())
    brier = 1 - ((predicted - large) ** 2).mean() / (large.mean() * (1 - large.mean()))
    summary = {"fires": len(fires), "large": int(large.sum()), "auc": auc, "brier_skill": float(brier)}
    print(json.dumps(summary | {"penalty": penalty, "wfpi_median": float(fires["wfpi"].median())}))


if __name__ == "__main__":
    main()
