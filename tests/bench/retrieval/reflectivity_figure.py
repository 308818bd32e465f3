"""Simulated reflectivities beside the real ones over Texas: ``python -m tests.bench.retrieval.reflectivity_figure``.

Writes ``docs/images/retrieval_reflectivity_texas.png`` (or the path given) and prints the quantiles. Real: CYGNSS
level-1 specular points of 2024, whose SNR becomes a power with kTB (550 K, 1 kHz). Simulated: nominal maps of five
random worlds, read back through the level-1 reader. Both are cut at an SNR of 1 dB. Needs SMOKEGLINT_DATA.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from services.retrieval.constants import BOLTZMANN_J_K
from services.retrieval.level1.land_screening import LandLimits
from services.retrieval.level1.reflectivity import reflectivity_db
from services.retrieval.looks.features import read_observations
from services.retrieval.simulation.observations import simulate_nominal
from services.retrieval.simulation.training_world import DAY_MS, WorldPlan, make_specular_points, make_surface
from shared import figures
from shared.versions import RELEASE

TEXAS = "gnssr/texas_2024/CYGNSS_Texas_202403_202409.parquet"
PICTURE = "docs/images/retrieval_reflectivity_texas.png"
MIN_SNR_DB = 1.0
SHARES = (0.05, 0.5, 0.95)
WORLDS = [WorldPlan(6500 + n, 28.0 + 2.0 * n, -103.0 + 1.5 * n, first_day="2024-03-01") for n in range(5)]
ATTRIBUTES = {"simulated": True, "simulated_share": 0.5, "oldest_input": "2024-03-01", "code_version": RELEASE}


def real_looks(data: Path) -> pd.DataFrame:
    """``reflectivity_db``, ``snr_db`` and ``incidence_deg`` of the real points that pass the cut."""
    raw = pd.read_parquet(data / TEXAS)
    raw = raw[raw["ddm_snr"] > MIN_SNR_DB]
    power_w = BOLTZMANN_J_K * 550.0 * 1000.0 * 10.0 ** (raw["ddm_snr"].to_numpy() / 10.0)
    eirp_w = 10.0 ** ((raw["gps_tx_power_db_w"] + raw["gps_ant_gain_db_i"]).to_numpy() / 10.0)
    ranges = raw["rx_to_sp_range"].to_numpy(float), raw["tx_to_sp_range"].to_numpy(float)
    return pd.DataFrame(
        {
            "reflectivity_db": reflectivity_db(power_w, eirp_w, raw["sp_rx_gain"].to_numpy(), *ranges),
            "snr_db": raw["ddm_snr"].to_numpy(),
            "incidence_deg": raw["sp_inc_angle"].to_numpy(),
        }
    )


def simulated_looks() -> pd.DataFrame:
    """The same of ten days of each simulated world before its fires."""
    frames = []
    with tempfile.TemporaryDirectory() as folder:
        for plan in WORLDS:
            points = make_specular_points(plan, plan.first_ms, plan.first_ms + 10 * DAY_MS, 0)
            path = Path(folder) / f"{plan.seed}.nc"
            simulate_nominal(points, make_surface(plan), plan.seed).write(path, {})
            frames.append(read_observations([path], LandLimits(min_snr_db=MIN_SNR_DB)).looks)
    return pd.concat(frames, ignore_index=True)[["reflectivity_db", "snr_db", "incidence_deg"]]


def draw(real: pd.DataFrame, simulated: pd.DataFrame, path: Path) -> None:
    """Distributions of reflectivity and of SNR, real and simulated."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.4))
    panels = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.07, right=0.985, top=0.88, bottom=0.17, wspace=0.18)
    for axes, (name, label, low, high) in zip(
        panels,
        (("reflectivity_db", "effective reflectivity (dB)", -40.0, 0.0), ("snr_db", "SNR (dB)", 0.0, 25.0)),
        strict=True,
    ):
        bins = np.arange(low, high + 0.5, 0.5)
        for looks, text, colour in ((real, "CYGNSS, Texas 2024", "#1f5fa8"), (simulated, "simulated", "#d9620f")):
            quantiles = looks[name].quantile(list(SHARES))
            short = "/".join(f"{value:.1f}" for value in quantiles)
            options = {"density": True, "histtype": "step", "linewidth": 1.6, "color": colour}
            axes.hist(looks[name], bins, label=f"{text}: {short}\n({len(looks)} looks)", **options)
            for value in quantiles:
                axes.axvline(value, color=colour, linewidth=0.8, linestyle=":")
        axes.set_xlabel(label)
        axes.set_ylabel("density (1/dB)")
        axes.set_ylim(0.0, 1.4 * axes.get_ylim()[1])
        axes.legend(fontsize=8, title="5/50/95 %", title_fontsize=8, loc="upper right")
        axes.grid(alpha=0.3)
    figure.suptitle(f"Reflectivity: real and simulated, both cut at SNR > {MIN_SNR_DB:g} dB", fontsize=11)
    figures.save(figure, path, ATTRIBUTES)


def main() -> None:
    """Draw the figure and print the quantiles."""
    real, simulated = real_looks(Path(os.environ["SMOKEGLINT_DATA"])), simulated_looks()
    draw(real, simulated, Path(sys.argv[1] if len(sys.argv) > 1 else PICTURE))
    for text, looks in (("real", real), ("simulated", simulated)):
        found = {name: looks[name].quantile(list(SHARES)).round(2).tolist() for name in ("reflectivity_db", "snr_db")}
        print(json.dumps({"looks": text, "count": len(looks), **found}))


if __name__ == "__main__":
    main()
