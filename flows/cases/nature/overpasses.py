"""What polar orbiters see of the fires: VIIRS- and MODIS-like overpasses, with clouds, misses and late delivery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from pyproj import Transformer

from flows.cases.nature.fields import KM_PER_DEG, RandomField, random_field
from flows.cases.nature.setting import FloatArray, Setting
from flows.cases.nature.spread import FireGrid

RESIDENCE_H = 8.0  # how long a cell stays hot enough to be seen
# satellite, instrument, local solar hour of the day pass, nadir pixel in m
SATELLITES = (
    ("SUOMI NPP", "VIIRS", 13.4, 375.0),
    ("NOAA 20", "VIIRS", 12.6, 375.0),
    ("TERRA", "MODIS", 10.5, 1000.0),
    ("AQUA", "MODIS", 13.6, 1000.0),
)
DETECT = {"VIIRS": 0.75, "MODIS": 0.5}
MAX_LATENCY_H, MIN_LATENCY_H = 6.0, 1.5
WIDE_STEP_DEG = 0.15
LOOKS_AROUND = 260
CLOUD_THRESHOLD = 0.9


@dataclass(frozen=True)
class Overpass:
    """One pass: time in hours since the run's start, pixel size in m, direction of flight in degrees from north."""

    satellite: str
    instrument: str
    time_h: float
    along_m: float
    across_m: float
    heading_deg: float
    latency_h: float


@dataclass(frozen=True)
class Clouds:
    """A cloud field that drifts with a steady wind (km/h east and north) and slowly changes."""

    field: RandomField
    drift_km_h: tuple[float, float]

    def hide(self, longitude: FloatArray, latitude: FloatArray, time_h: float) -> np.ndarray:
        """True where cloud hides the ground."""
        east = longitude - self.drift_km_h[0] * time_h / (KM_PER_DEG * 0.83)
        north = latitude - self.drift_km_h[1] * time_h / KM_PER_DEG
        return self.field.at(east, north, time_h) > CLOUD_THRESHOLD


def make_clouds(setting: Setting) -> Clouds:
    """The clouds from the setting's seed."""
    rng = setting.generator("clouds")
    return Clouds(random_field(rng, 45.0, correlation_h=18.0), (15.0, 6.0))


def overpass_times(setting: Setting, from_h: float) -> list[Overpass]:
    """All overpasses from ``from_h`` to the end, up to eight a day, in order of time."""
    rng = setting.generator("overpasses")
    passes = []
    for day in range(int(from_h // 24), int(setting.end_h // 24) + 2):
        for satellite, instrument, local_hour, pixel in SATELLITES:
            for half in (0.0, 12.0):
                solar = local_hour + half + rng.uniform(-0.7, 0.7)
                time = 24.0 * day + solar - setting.start.hour - setting.centre[0] / 15.0
                bend = (abs(rng.uniform(-1, 1)), rng.uniform(MIN_LATENCY_H, MAX_LATENCY_H), rng.uniform())
                if bend[2] < 0.12 or not from_h <= time <= setting.end_h:
                    continue  # the swaths leave gaps
                along, across = _pixel(instrument, pixel, bend[0])
                heading = 190.0 if half == 0.0 else 350.0
                passes.append(Overpass(satellite, instrument, time, along, across, heading, bend[1]))
    return sorted(passes, key=lambda one: (one.time_h, one.satellite))


def _pixel(instrument: str, nadir_m: float, edge: float) -> tuple[float, float]:
    """Pixel along and across track, m, at a share ``edge`` of the swath's half width; VIIRS limits its growth."""
    growth = (1.1, 1.1) if instrument == "VIIRS" else (1.0, 3.8)
    return nadir_m * (1 + growth[0] * edge**2), nadir_m * (1 + growth[1] * edge**3)


def observe(setting: Setting, fires: list[FireGrid], known_h: dict[str, float], from_h: float) -> pd.DataFrame:
    """The detections table of the case: fire and no-fire looks of every overpass (contract ``detections``).

    Around a fire looks are dense only once it has been detected or is known (``known_h``: hours since start by
    incident); elsewhere they lie on a wide lattice, so that the looks themselves give no fire away in advance.
    """
    clouds, rng = make_clouds(setting), setting.generator("looks")
    noticed: dict[str, float] = dict(known_h)
    frames = []
    for one in overpass_times(setting, from_h):
        looks = [_wide_looks(setting, fires, one, rng)]
        for fire in fires:
            seen = _fire_looks(fire, one, rng, clouds)
            if seen.fire.any():
                noticed[fire.incident_id] = min(noticed.get(fire.incident_id, np.inf), one.time_h)
            dense = one.time_h >= noticed.get(fire.incident_id, np.inf)
            looks.append(_thinned(seen, rng) if dense else seen[seen.fire])
        table = pd.concat([look for look in looks if len(look)], ignore_index=True)
        hidden = clouds.hide(table.longitude_deg.to_numpy(), table.latitude_deg.to_numpy(), one.time_h)
        frames.append(_stamp(setting, table[~hidden | table.fire], one))
    return pd.concat(frames, ignore_index=True)


def _fire_looks(fire: FireGrid, one: Overpass, rng: np.random.Generator, clouds: Clouds) -> pd.DataFrame:
    """Every pixel over a fire's window: centre, whether fire was seen, power."""
    heading = np.radians(one.heading_deg)
    x, y = np.meshgrid(fire.x_m, fire.y_m)
    along = x * np.sin(heading) + y * np.cos(heading)
    across = x * np.cos(heading) - y * np.sin(heading)
    shift = rng.uniform(0, 1, 2)
    line = np.floor(along / one.along_m + shift[0]).astype(np.int64)
    sample = np.floor(across / one.across_m + shift[1]).astype(np.int64)
    code = (line - line.min()) * (np.ptp(sample) + 1) + (sample - sample.min())
    pixels, which = np.unique(code.ravel(), return_inverse=True)
    age = one.time_h - fire.arrival_h.ravel()
    hot = np.bincount(which, weights=(age >= 0) & (age < RESIDENCE_H), minlength=len(pixels))
    count = np.bincount(which, minlength=len(pixels))
    x_mid = np.bincount(which, weights=x.ravel(), minlength=len(pixels)) / count
    y_mid = np.bincount(which, weights=y.ravel(), minlength=len(pixels)) / count
    seen = (hot > 0) & (rng.uniform(size=len(pixels)) < DETECT[one.instrument])
    back = Transformer.from_crs(fire.epsg, 4326, always_xy=True)
    longitude, latitude = back.transform(x_mid, y_mid)
    power = np.where(seen, hot * rng.lognormal(0.6, 0.6, len(pixels)), np.nan)
    looks = pd.DataFrame({"longitude_deg": longitude, "latitude_deg": latitude, "fire": seen, "frp_mw": power})
    return looks[~(seen & clouds.hide(longitude, latitude, one.time_h))]


def _thinned(looks: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """All fire looks and a bearable number of the others, drawn evenly over the window."""
    others = looks[~looks.fire]
    keep = np.sort(rng.permutation(len(others))[:LOOKS_AROUND])
    return pd.concat([looks[looks.fire], others.iloc[keep]])


def _wide_looks(setting: Setting, fires: list[FireGrid], one: Overpass, rng: np.random.Generator) -> pd.DataFrame:
    """No-fire looks on a wide lattice over the region, none within two pixels of a hot cell."""
    longitude, latitude = (part.ravel() for part in setting.mesh(WIDE_STEP_DEG))
    longitude = longitude + rng.uniform(-0.5, 0.5, longitude.shape) * WIDE_STEP_DEG
    latitude = latitude + rng.uniform(-0.5, 0.5, latitude.shape) * WIDE_STEP_DEG
    near = np.zeros(len(longitude), dtype=bool)
    for fire in fires:
        age = one.time_h - fire.arrival_h
        rows, columns = np.nonzero((age >= 0) & (age < RESIDENCE_H))
        if len(rows):
            x, y = Transformer.from_crs(4326, fire.epsg, always_xy=True).transform(longitude, latitude)
            gap = np.hypot(x[:, None] - fire.x_m[columns], y[:, None] - fire.y_m[rows]).min(axis=1)
            near |= gap < 2 * max(one.along_m, one.across_m)
    looks = pd.DataFrame({"longitude_deg": longitude, "latitude_deg": latitude, "fire": False, "frp_mw": np.nan})
    return looks[~near]


def _stamp(setting: Setting, looks: pd.DataFrame, one: Overpass) -> pd.DataFrame:
    rng = setting.generator(f"confidence {one.time_h:.6f} {one.satellite}")
    sure = np.where(looks.fire, np.round(55.0 + 45.0 * rng.beta(4.0, 1.6, len(looks))), np.nan)
    return looks.assign(
        time=pd.Timestamp(setting.time(one.time_h)),
        delivered_at=pd.Timestamp(setting.time(one.time_h + one.latency_h)),
        satellite=one.satellite,
        instrument=one.instrument,
        confidence=sure,
        along_m=round(one.along_m, 1),
        across_m=round(one.across_m, 1),
    )
