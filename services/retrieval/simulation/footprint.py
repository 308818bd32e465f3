"""Signal strengths of a specular reflection: coherent and diffuse, averaged over the footprint of one look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import WAVELENGTH_M
from services.retrieval.simulation.dielectric import soil_reflectivity, water_reflectivity
from services.retrieval.simulation.surface import FloatArray, Surface, SurfaceState, TimeArray

METRES_PER_DEGREE = 111_195.0
ALONG_TRACK_SHARES = np.linspace(-0.5, 0.5, 5)  # where along the motion of the look the surface is met
ACROSS_TRACK_M = np.array([-300.0, 0.0, 300.0])  # about half a first Fresnel zone to either side
RING_M, RING_POINTS = 5_000.0, 8  # the glistening zone, for the diffuse part
WATER_ROUGHNESS_CM = 0.6
SPECULAR_SPEED_M_S = 6_600.0  # of the specular point over ground


@dataclass(frozen=True)
class Strength:
    """Per look: coherent reflectivity, diffuse |R|^2 and slope variance, burned share of the footprint; all (n,)."""

    coherent: FloatArray
    diffuse: FloatArray
    slope_variance: FloatArray
    burned_share: FloatArray
    water_share: FloatArray


def strengths(
    surface: Surface,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    time: TimeArray,
    incidence_deg: FloatArray,
    bearing_deg: FloatArray,
    look_s: float,
) -> Strength:
    """Mean signal strengths over the footprint of each look, inputs (n,); ``look_s`` is the incoherent sum in s."""
    north, east = _offsets(bearing_deg, look_s * SPECULAR_SPEED_M_S)
    latitude = latitude_deg[:, None] + north / METRES_PER_DEGREE
    longitude = longitude_deg[:, None] + east / (METRES_PER_DEGREE * np.cos(np.deg2rad(latitude_deg))[:, None])
    when = np.broadcast_to(time[:, None], latitude.shape)
    state = surface.at(latitude, longitude, when)
    incidence = np.broadcast_to(incidence_deg[:, None], latitude.shape)
    attenuation = np.exp(-2.0 * state.vod / np.cos(np.deg2rad(incidence)))
    soil = soil_reflectivity(state.soil_moisture, state.clay_fraction, incidence) * attenuation
    water = water_reflectivity(incidence)
    share = state.water_fraction
    smooth = (1.0 - share) * soil * _coherence(state.roughness_cm, incidence) * 10.0 ** (-state.relief_loss_db / 10.0)
    smooth += share * water * _coherence(np.full_like(share, WATER_ROUGHNESS_CM), incidence)
    core = ALONG_TRACK_SHARES.size * ACROSS_TRACK_M.size
    return Strength(
        coherent=smooth[:, :core].mean(axis=1),
        diffuse=((1.0 - share) * soil + share * water).mean(axis=1),
        slope_variance=_slope_variance(state),
        burned_share=state.burned[:, :core].mean(axis=1),
        water_share=share[:, :core].mean(axis=1),
    )


def _coherence(roughness_cm: FloatArray, incidence_deg: FloatArray) -> FloatArray:
    """Share of the reflected power that stays coherent: exp(-4 k^2 s^2 cos^2 theta) (Rayleigh roughness)."""
    phase = 2.0 * np.pi / WAVELENGTH_M * roughness_cm / 100.0 * np.cos(np.deg2rad(incidence_deg))
    return np.exp(-4.0 * phase**2)


def _slope_variance(state: SurfaceState) -> FloatArray:
    """Mean square slope of the patch: rises with the square of roughness (correlation length about 25 cm)."""
    return np.clip(2.0 * (state.roughness_cm.mean(axis=1) / 25.0) ** 2, 0.003, 0.1)


def _offsets(bearing_deg: FloatArray, travel_m: float) -> tuple[FloatArray, FloatArray]:
    """North and east offsets (m) of the footprint points, (n, points): core first, then the ring."""
    along, across = np.meshgrid(ALONG_TRACK_SHARES * travel_m, ACROSS_TRACK_M, indexing="ij")
    angle = np.arange(RING_POINTS) * 2.0 * np.pi / RING_POINTS
    forward = np.concatenate([along.ravel(), RING_M * np.cos(angle)])
    sideways = np.concatenate([across.ravel(), RING_M * np.sin(angle)])
    bearing = np.deg2rad(bearing_deg)[:, None]
    return (
        forward * np.cos(bearing) - sideways * np.sin(bearing),
        forward * np.sin(bearing) + sideways * np.cos(bearing),
    )


def track_bearing_deg(
    track: NDArray[np.intp], latitude_deg: FloatArray, longitude_deg: FloatArray, seconds: FloatArray
):
    """Bearing of motion (n,) from neighbouring points of a track; input sorted by track, then time.

    ``track`` numbers tracks. A lone point gets 45 deg, the commonest ground-track direction of a 35 deg orbit.
    """
    bearing = np.full(latitude_deg.size, 45.0)
    follows = (np.diff(track) == 0) & (np.diff(seconds) <= 5.0) & (np.diff(seconds) > 0.0)
    east = (np.diff(longitude_deg) + 180.0) % 360.0 - 180.0
    east = east * np.cos(np.deg2rad(latitude_deg[:-1]))
    steps = np.rad2deg(np.arctan2(east, np.diff(latitude_deg)))
    bearing[1:][follows] = steps[follows]
    bearing[:-1][follows] = steps[follows]
    return bearing
