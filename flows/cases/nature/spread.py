"""Fire spread: minimum travel time over a grid of cells, with wind and fuel moisture that change by the hour.

Each cell passes fire to 16 neighbours at the rate of an ellipse with the ignition at its rear focus. Rates are a
product of a place (fuel, slope along the way) and an hour (wind, fuel moisture), so the travel along an edge is
integrated exactly; leaving later never means arriving earlier, so Dijkstra's algorithm gives the exact minimum
(Finney 2002, doi:10.1139/x02-068; time-dependent: Dreyfus 1969).
"""

from __future__ import annotations

import heapq
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from pyproj import Transformer

from flows.cases.nature.fields import smooth_step
from flows.cases.nature.land import Land
from flows.cases.nature.setting import FloatArray, Ignition, Setting
from flows.cases.nature.weather import Weather

NEIGHBOURS = tuple(
    (row, column)
    for row in range(-2, 3)
    for column in range(-2, 3)
    if (row, column) != (0, 0) and np.gcd(row, column) == 1
)
SLOPE_PER_DEG = 0.069  # McArthur: the rate doubles every 10 degrees uphill (Noble et al. 1980)
MAX_SLOPE_DEG = 25.0
WIND_SHARE, CALM_M_S = 0.025, 0.005


@dataclass(frozen=True)
class FireGrid:
    """Fire arrival on a UTM grid: hours since the run's start, NaN unburned, shape (y, x); ``y`` ascends, metres."""

    incident_id: str
    x_m: FloatArray
    y_m: FloatArray
    epsg: int
    arrival_h: FloatArray


def head_rate_m_h(wind_m_s: FloatArray, moisture_pct: FloatArray) -> FloatArray:
    """Head fire rate of standard fuel, m/h, 10 m wind in m/s.

    Proportional to the wind (the 10 % rule of Cruz and Alexander 2019, doi:10.1186/s13595-019-0829-8, holds for crown
    and scrub fire; mixed timber here takes ``WIND_SHARE``), damped by fuel moisture as in Cheney et al. (1998) and
    extinguished at 24 %.
    """
    damping = np.exp(-0.108 * moisture_pct) * smooth_step(24.0 - moisture_pct, 0.0, 8.0)
    return 3600.0 * (CALM_M_S + WIND_SHARE * wind_m_s) * damping


def length_to_breadth(wind_m_s: FloatArray) -> FloatArray:
    """Length to breadth of the fire ellipse (Anderson 1983 as in FARSITE), midflame wind 0.4 of the 10 m wind."""
    midflame = 0.4 * np.asarray(wind_m_s)
    ratio = 0.936 * np.exp(0.2566 * midflame) + 0.461 * np.exp(-0.1548 * midflame) - 0.397
    return np.clip(ratio, 1.0, 8.0)


def dead_fuel_moisture_pct(temperature_c: FloatArray, humidity_pct: FloatArray) -> FloatArray:
    """Equilibrium moisture of fine dead fuel, % (Simard 1968, the form that Fosberg 1978 uses)."""
    t, h = np.asarray(temperature_c) * 1.8 + 32.0, np.asarray(humidity_pct)
    low = 0.03229 + 0.281073 * h - 0.000578 * h * t
    middle = 2.22749 + 0.160107 * h - 0.014784 * t
    high = 21.0606 + 0.005565 * h**2 - 0.00035 * h * t - 0.483199 * h
    return np.clip(np.where(h <= 10, low, np.where(h <= 50, middle, high)), 1.0, 35.0)


def travelled_by_direction(wind_m_s: FloatArray, wind_from_deg: FloatArray, moisture_pct: FloatArray) -> FloatArray:
    """Metres that fire would have gone by each hour in each neighbour's direction, shape (16, hours + 1)."""
    head = head_rate_m_h(wind_m_s, moisture_pct)
    ratio = length_to_breadth(wind_m_s)
    eccentricity = np.sqrt(1.0 - 1.0 / ratio**2)
    bearings = np.array([np.arctan2(column, row) for row, column in NEIGHBOURS])
    off_axis = bearings[:, None] - np.radians(wind_from_deg + 180.0)[None, :]
    rates = head * (1.0 - eccentricity) / (1.0 - eccentricity * np.cos(off_axis))
    return np.concatenate([np.zeros((len(NEIGHBOURS), 1)), np.cumsum(rates, axis=1)], axis=1)


def effective_distances(fuel: FloatArray, elevation_m: FloatArray, cell_m: float) -> FloatArray:
    """Metres of level standard fuel that each cell's edge to each neighbour counts for (16, y, x); inf: no way."""
    height, width = fuel.shape
    padded_fuel = np.pad(fuel, 2)
    padded_up = np.pad(elevation_m, 2, mode="edge")
    result = np.empty((len(NEIGHBOURS), height, width))
    for number, (row, column) in enumerate(NEIGHBOURS):
        window = (slice(2 + row, 2 + row + height), slice(2 + column, 2 + column + width))
        distance = cell_m * np.hypot(row, column)
        slope = np.degrees(np.arctan((padded_up[window] - elevation_m) / distance))
        uphill = np.exp(SLOPE_PER_DEG * np.clip(slope, -MAX_SLOPE_DEG, MAX_SLOPE_DEG))
        burnable = (fuel > 0) & (padded_fuel[window] > 0)
        rate = np.where(burnable, 0.5 * (fuel + padded_fuel[window]) * uphill, 1.0)
        result[number] = np.where(burnable, distance / rate, np.inf)
    return result


def minimum_arrival_h(
    distances: FloatArray, travelled_m: FloatArray, origin: tuple[int, int], start_h: float
) -> FloatArray:
    """Earliest arrival, h on the clock of ``travelled_m`` (column 0 is hour 0), NaN where not reached in time.

    ``distances`` (16, y, x) of :func:`effective_distances`, ``travelled_m`` (16, hours + 1) of
    :func:`travelled_by_direction`, ``origin`` the (row, column) of the ignition at ``start_h``.
    """
    _, height, width = distances.shape
    edges = distances.reshape(len(NEIGHBOURS), -1).T.tolist()
    curves = travelled_m.tolist()
    last = travelled_m.shape[1] - 1
    arrival = [np.inf] * (height * width)
    first = origin[0] * width + origin[1]
    arrival[first] = start_h
    queue = [(start_h, first)]
    while queue:
        now, cell = heapq.heappop(queue)
        if now > arrival[cell]:
            continue
        row, column = divmod(cell, width)
        hour = min(int(now), last - 1)
        part = now - hour
        for number, (down, right) in enumerate(NEIGHBOURS):
            to_row, to_column = row + down, column + right
            if not (0 <= to_row < height and 0 <= to_column < width):
                continue
            curve = curves[number]
            goal = curve[hour] + part * (curve[hour + 1] - curve[hour]) + edges[cell][number]
            if goal >= curve[last]:
                continue
            after = bisect_left(curve, goal, hour)
            then = after - (curve[after] - goal) / (curve[after] - curve[after - 1])
            other = to_row * width + to_column
            if then < arrival[other]:
                arrival[other] = then
                heapq.heappush(queue, (then, other))
    result = np.array(arrival).reshape(height, width)
    return np.where(np.isfinite(result), result, np.nan)


def burn(setting: Setting, land: Land, weather: Weather, ignition: Ignition) -> FireGrid:
    """The fire of one ignition until the end of the run, under the weather at the ignition point."""
    to_utm = Transformer.from_crs(4326, setting.utm_epsg, always_xy=True)
    centre = np.array(to_utm.transform(ignition.longitude_deg, ignition.latitude_deg))
    cells = int(ignition.half_width_km * 1000 / setting.cell_m)
    middle = np.floor(centre / setting.cell_m) * setting.cell_m + setting.cell_m / 2
    steps = setting.cell_m * np.arange(-cells, cells + 1)
    x_m, y_m = middle[0] + steps, middle[1] + steps
    back = Transformer.from_crs(setting.utm_epsg, 4326, always_xy=True)
    longitude, latitude = back.transform(*np.meshgrid(x_m, y_m))
    fuel = land.fuel_factor(longitude, latitude)
    hearth = (slice(cells - 1, cells + 2), slice(cells - 1, cells + 2))
    fuel[hearth] = np.maximum(fuel[hearth], 0.6)  # fires are reported where something burns
    distances = effective_distances(fuel, land.elevation_m(longitude, latitude), setting.cell_m)
    start_h = setting.cutoff_h + ignition.start_h
    hours = np.arange(np.floor(start_h), np.ceil(setting.end_h))
    air = weather.at(ignition.longitude_deg, ignition.latitude_deg, hours + 0.5)
    moisture = dead_fuel_moisture_pct(air["temperature_c"], air["relative_humidity_pct"])
    travelled = travelled_by_direction(air["wind_speed_m_s"], air["wind_direction_deg"], moisture)
    arrival = minimum_arrival_h(distances, travelled, (cells, cells), start_h - hours[0]) + hours[0]
    return FireGrid(ignition.incident_id, x_m, y_m, setting.utm_epsg, arrival)
