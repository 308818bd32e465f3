"""How the real fires of a day burn for the simulators, and what satellites would have seen of it: simulated."""

from __future__ import annotations

from dataclasses import replace

import geopandas
import numpy as np
import pandas as pd

from flows.cases.nature.overpasses import observe
from flows.cases.nature.setting import Setting
from flows.cases.nature.spread import FireGrid
from flows.cases.scoring import polygonal
from flows.cases.wfigs import TRUSTED_WITHIN, arrival_between

MOST_FIRES = 2
LEAST_ACRES = 100.0
LOOKS_BEFORE_H = 48.0
WINDOW_DEG = 0.6  # of looks about a fire


def burning_fires(table: geopandas.GeoDataFrame, fires: pd.DataFrame, setting: Setting) -> list[FireGrid]:
    """A fire arrival for each of the largest mapped fires, shared out between its outlines; a stand-in, no observation.

    An outline is dated as it says where that can be trusted, else when it was published. Later outlines enter: this is
    what nature does, not what anybody knows of it.
    """
    mapped = table[table["unique_fire_id"].isin(fires["incident_id"])]
    largest = mapped.groupby("unique_fire_id")["acres"].max().sort_values(ascending=False)
    chosen = sorted(largest[largest >= LEAST_ACRES].index[:MOST_FIRES])
    by_id = fires.set_index("incident_id")
    return [_burning(mapped[mapped["unique_fire_id"] == name], by_id.loc[name], setting) for name in chosen]


def _burning(own: geopandas.GeoDataFrame, fire: pd.Series[object], setting: Setting) -> FireGrid:
    own = own.to_crs(4326)
    age = own["scraped"] - own["polygon_time"]
    trusted = (age >= pd.Timedelta(0)) & (age < TRUSTED_WITHIN) & (own["polygon_time"] > fire["start"])
    dated = own["polygon_time"].where(trusted, own["scraped"])
    outlines = geopandas.GeoDataFrame(
        {"incident_id": own["unique_fire_id"].to_numpy(), "time": dated.astype("datetime64[ms, UTC]").to_numpy()},
        geometry=[polygonal(shape) for shape in own.geometry],
        crs=4326,
    ).sort_values("time", kind="stable")
    outlines["time"] = pd.to_datetime(outlines["time"], utc=True)
    place = (float(fire["longitude_deg"]), float(fire["latitude_deg"]))  # type: ignore[arg-type]
    if not outlines.geometry.iloc[0].buffer(0.02).contains(geopandas.points_from_xy([place[0]], [place[1]])[0]):
        middle = outlines.geometry.iloc[0].representative_point()  # a place to 0.1 degree may lie beside the fire
        place = (middle.x, middle.y)
    epsg = 32600 + int((place[0] + 180) // 6) + 1
    return arrival_between(outlines, place, fire["start"], setting.start, epsg=epsg, cell_m=setting.cell_m)  # type: ignore[arg-type]


def simulated_detections(setting: Setting, burning: list[FireGrid], fires: pd.DataFrame) -> pd.DataFrame:
    """Looks of VIIRS and MODIS about each burning fire, from two days before the cut-off on (no geometry yet)."""
    known = fires.set_index("incident_id")["known_at"]
    places = fires.set_index("incident_id")[["longitude_deg", "latitude_deg"]]
    frames = []
    for number, fire in enumerate(burning):
        x, y = places.loc[fire.incident_id]
        around = (x - WINDOW_DEG, y - WINDOW_DEG, x + WINDOW_DEG, y + WINDOW_DEG)
        hours = (known[fire.incident_id] - pd.Timestamp(setting.start)) / pd.Timedelta(hours=1)
        own = replace(setting, region=around, seed=setting.seed + number)
        frames.append(observe(own, [fire], {fire.incident_id: float(hours)}, setting.cutoff_h - LOOKS_BEFORE_H))
    table = pd.concat(frames, ignore_index=True)
    return table.sort_values(["time", "satellite"], kind="stable", ignore_index=True)


def burn_times(setting: Setting, burning: list[FireGrid]) -> np.ndarray:
    """Earliest burn time on the burn grid: s since the run's start, NaN unburned."""
    from flows.cases.nature.run import burn_grid

    return burn_grid(setting, tuple(burning))
