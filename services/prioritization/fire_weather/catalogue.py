"""What each index is: unit, variant, source, who computes it and how well it agrees with its reference.

The agreement figures are what tests/services/prioritization/test_prioritization_indices.py measures.
"""

from __future__ import annotations

from dataclasses import dataclass

LIBRARY = "climate-indices 3.1"
HERE = "this service"


@dataclass(frozen=True)
class IndexStatement:
    """One index of ``services.prioritization.indices``: function, unit of the result, and its pedigree."""

    function: str
    index: str
    unit: str
    variant: str
    source: str
    computed_by: str
    agreement: str


CATALOGUE = (
    IndexStatement(
        "canadian",
        "FFMC, DMC, DC, ISI, BUI, FWI",
        "1",
        "noon local standard weather; FFMC with 250 x 59.5 / 101 = 147.27723; start-up 85/6/15, resumable state",
        "Van Wagner 1987; Van Wagner & Pickett 1985",
        LIBRARY,
        "cffdrs, 48 days: DMC, DC, BUI 1e-9; FFMC 0.001 with its constant (0.12 from a file made with 147.2, FWI "
        "0.24); GFWED, 4 sites: FFMC 0.25, DMC 0.25, DC 0.5, BUI 0.35, FWI 1.5 (147.2 and float32 there)",
    ),
    IndexStatement(
        "overwintered_dc",
        "DC at start-up",
        "1",
        "carry-over and wetting efficiency 0.75 each unless given; seasons by temperature (Wotton & Flannigan 1993) "
        "and the winters between them in fire_weather.seasons.canadian_years",
        "Lawson & Armitage 2008",
        LIBRARY,
        "three places of two years against a DC by hand: 0.02",
    ),
    IndexStatement(
        "kbdi",
        "KBDI",
        "mm, 0-203.2",
        "equation 18, metric, 8.30 (0.830 is a misprint); wet-spell rain beyond 5.08 mm; no drying below 10 degC. Not "
        "the Australian (Finkele) variant that xclim follows",
        "Keetch & Byram 1968; Alexander 1990",
        LIBRARY,
        "equation by hand 1e-9; the imperial form 0.1 %",
    ),
    IndexStatement(
        "fosberg",
        "FFWI",
        "1, 0-100",
        "equilibrium moisture of Simard 1968; 10 and 50 % humidity belong to the lower branch; capped at 100",
        "Fosberg 1978",
        LIBRARY,
        "by hand 0.001; m = 0 and 30 mph give 100",
    ),
    IndexStatement(
        "haines",
        "Haines index",
        "1, 2-6",
        "low 950/850 hPa, mid 850/700, high 700/500; moisture at 850, 850, 700 hPa",
        "Haines 1988",
        LIBRARY,
        "published bins, exact",
    ),
    IndexStatement(
        "hot_dry_windy",
        "HDW",
        "hPa m/s",
        "largest product of vapour pressure deficit and wind of the levels within 500 m above ground",
        "Srock et al. 2018",
        LIBRARY,
        "by hand 0.1 % (saturation pressure FAO-56)",
    ),
    IndexStatement(
        "large_fire_potential",
        "LFP, LFP without fuel",
        "1",
        "0.001 Ws2 Dd FMC, Ws in mph and Dd in degF inside, SI outside; FMC 1 is LFP without fuel",
        "Rolinski et al. 2016",
        HERE,
        "40 mph and 50 degF give 80, 1e-4",
    ),
    IndexStatement(
        "fuel_moisture_component",
        "FMC of LFP",
        "1, 0-1",
        "(0.1 [(DL/LFM - 1) + G])^1.7, read so that the driest fuels give 1; the paper itself could not be consulted",
        "Rolinski et al. 2016, at second hand",
        HERE,
        "range only",
    ),
    IndexStatement(
        "sawti_category",
        "SAWTI category",
        "1, 0-4",
        "thresholds of zones 1-4 in Southern California",
        "Rolinski et al. 2016, thresholds as in firewxpy",
        HERE,
        "thresholds, exact",
    ),
    IndexStatement(
        "fuel_moisture_10h_pct",
        "10-h dead fuel moisture",
        "%",
        "1.28 x equilibrium moisture of the hour's air; the time-lag model with stations is forecast-fuel-moisture",
        "Burgan 1998; Simard 1968",
        HERE,
        "equilibrium by hand 0.001",
    ),
    IndexStatement(
        "forest_fire_danger",
        "FFDI",
        "1",
        "McArthur Mark 5 in closed form; drought factor given, or its limit without recent rain (Griffiths 1999)",
        "Noble et al. 1980",
        HERE,
        "Victorian column: median 0.05 (rounded inputs)",
    ),
    IndexStatement(
        "equilibrium_ffmc",
        "FFMC in balance with the air",
        "1",
        "drying equilibrium of FFMC, no rain and no yesterday; stands in where there is no series of days",
        "Van Wagner 1987, equation 8a",
        HERE,
        "limit of the FFMC recursion under steady air, 0.01",
    ),
)


def markdown() -> str:
    """The catalogue as a table for the documentation."""
    lines = ["| index | unit | variant | source | computed by | agreement |", "|---|---|---|---|---|---|"]
    lines += [
        f"| {row.index} (`{row.function}`) | {row.unit} | {row.variant} | {row.source} | {row.computed_by} | "
        f"{row.agreement} |"
        for row in CATALOGUE
    ]
    return "\n".join(lines)
