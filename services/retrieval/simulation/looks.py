"""Which specular points become maps, and in which sample and channel of a level-1 file each one stands."""

from __future__ import annotations

import numpy as np
import pandas as pd

from services.retrieval.level1.writer import CHANNELS

METRICS = ["satellite", "transmitter", "time", "incidence_deg", "rx_gain_dbi", "rx_range_m", "tx_range_m"]


def looks_table(specular_points: pd.DataFrame) -> pd.DataFrame:
    """Plain table of looks from a specular_points table, sorted by satellite, transmitter and time.

    Adds ``latitude_deg``, ``longitude_deg``, ``time_ms`` (int64 since 1970) and ``track`` (number of the
    satellite-transmitter pair).
    """
    looks = pd.DataFrame({name: specular_points[name].to_numpy() for name in METRICS if name != "time"})
    looks["longitude_deg"] = specular_points.geometry.x.to_numpy()
    looks["latitude_deg"] = specular_points.geometry.y.to_numpy()
    times = pd.to_datetime(specular_points["time"], utc=True).dt.tz_localize(None)
    looks["time_ms"] = times.to_numpy().astype("datetime64[ms]").astype(np.int64)
    if "nominal" in specular_points.columns:
        looks["nominal"] = specular_points["nominal"].to_numpy(dtype=bool)
    looks = looks[looks["transmitter"].astype(str).str.startswith("G")]  # the C/A ambiguity function is GPS's own
    looks = looks.sort_values(["satellite", "transmitter", "time_ms"], kind="stable", ignore_index=True)
    looks["track"] = looks.groupby(["satellite", "transmitter"], sort=True).ngroup()
    return looks


def nominal_looks(looks: pd.DataFrame) -> pd.DataFrame:
    """The looks that the on-board tracker follows: column ``nominal`` where given, else four best gains a second."""
    if "nominal" in looks.columns:
        chosen = looks[looks["nominal"]]
    else:
        rank = looks.groupby(["satellite", "time_ms"])["rx_gain_dbi"].rank(method="first", ascending=False)
        chosen = looks[rank <= CHANNELS]
    return place_in_samples(chosen)


def raw_if_looks(looks: pd.DataFrame, images: pd.DataFrame, min_gain_dbi: float = 0.0) -> pd.DataFrame:
    """Every look in the antenna beams during a collected raw-IF second (half-open ``start``..``end``), with its image.

    ``images`` follows the as_run contract; lost images hold nothing.
    """
    kept = images[images["status"] != "lost"] if "status" in images.columns else images
    seconds = _seconds_of(kept)
    beams = looks[looks["rx_gain_dbi"] > min_gain_dbi]
    found = beams.assign(second=beams["time_ms"] // 1000).merge(seconds, on=["satellite", "second"], how="inner")
    return place_in_samples(found.drop(columns="second"))


def _seconds_of(images: pd.DataFrame) -> pd.DataFrame:
    start = pd.to_datetime(images["start"], utc=True).dt.tz_localize(None).to_numpy().astype("datetime64[s]")
    end = pd.to_datetime(images["end"], utc=True).dt.tz_localize(None).to_numpy().astype("datetime64[s]")
    length = np.maximum((end - start).astype(np.int64), 0)
    index = np.repeat(np.arange(len(images)), length)
    offset = np.arange(index.size) - np.repeat(np.cumsum(length) - length, length)
    table = pd.DataFrame(
        {
            "satellite": images["satellite"].to_numpy(dtype=object)[index],
            "second": start.astype(np.int64)[index] + offset,
            "image_id": images["image_id"].to_numpy()[index].astype(np.int64),
        }
    )
    return table.drop_duplicates(["satellite", "second"])


def place_in_samples(looks: pd.DataFrame) -> pd.DataFrame:
    """Number the looks of a satellite-second 0..3 (column ``ddm``) in samples; a fifth look opens a further sample."""
    ordered = looks.sort_values(["time_ms", "satellite", "rx_gain_dbi"], ascending=[True, True, False], kind="stable")
    position = ordered.groupby(["time_ms", "satellite"], sort=False).cumcount().to_numpy()
    block = position // CHANNELS
    changed = (
        (ordered["time_ms"].diff() != 0)
        | (ordered["satellite"] != ordered["satellite"].shift())
        | (np.diff(block, prepend=-1) != 0)
    )
    sample = np.cumsum(changed.to_numpy()) - 1
    return ordered.assign(ddm=position % CHANNELS, sample=sample).reset_index(drop=True)
