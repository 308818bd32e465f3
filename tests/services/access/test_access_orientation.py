"""Frames against Vallado's worked example (Fundamentals of Astrodynamics, 2013, example 3-15)."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from services.access.orbits.orientation import (
    ARCSEC_RAD,
    Orientation,
    eme2000_to_gcrs,
    gcrs_to_itrf,
    gmst82_rad,
    orientation_at,
    teme_to_itrf,
)

WHEN = datetime(2004, 4, 6, 7, 51, 28, 386009, tzinfo=UTC)
VALLADO = Orientation(WHEN, -0.140682 * ARCSEC_RAD, 0.333309 * ARCSEC_RAD, -0.4399619, True)
ITRF_KM = np.array([[-1033.4793830, 7901.2952754, 6380.3565958]])
ITRF_KM_S = np.array([[-3.225636520, -2.872451450, 5.531924446]])


def test_teme_to_itrf_agrees_with_the_published_state() -> None:
    position = np.array([[5094.18016210, 6127.64465950, 6380.34453270]])
    velocity = np.array([[-4.746131487, 0.785818041, 5.531931288]])
    found, rate = teme_to_itrf(position, velocity, np.zeros(1), VALLADO)
    assert np.abs(found - ITRF_KM).max() < 1e-4
    assert np.abs(rate - ITRF_KM_S).max() < 1e-6


def test_gcrs_to_itrf_agrees_with_the_published_state() -> None:
    position = np.array([[5102.508958, 6123.011401, 6378.136928]])
    velocity = np.array([[-4.743220161, 0.790536492, 5.533755724]])
    found, rate = gcrs_to_itrf(position, velocity, np.zeros(1), VALLADO)
    assert np.abs(found - ITRF_KM).max() < 2e-5  # 2 cm: the example adds the pole's observed offsets
    assert np.abs(rate - ITRF_KM_S).max() < 1e-7


def test_eme2000_differs_from_gcrs_by_the_bias_of_iers_conventions() -> None:
    """IERS Conventions (2010), 5.4.4: offsets of the pole -16.617 and -6.819 mas, of the equinox -14.6 mas."""
    turned = eme2000_to_gcrs(np.eye(3))
    assert turned[2, 0] / ARCSEC_RAD == pytest.approx(-0.016617, abs=2e-6)
    assert turned[2, 1] / ARCSEC_RAD == pytest.approx(-0.006819, abs=2e-6)
    assert abs(turned[0, 1] / ARCSEC_RAD) == pytest.approx(0.0146, abs=1e-5)


def test_nodes_of_precession_do_not_show() -> None:
    """A day at once, and each of its moments by itself, give the same to a tenth of a millimetre."""
    t_s = np.linspace(0.0, 86400.0, 97)
    position = np.tile([7.0e6, 1.0e6, 2.0e6], (97, 1))
    at_once, _ = gcrs_to_itrf(position, position, t_s, VALLADO)
    alone = [gcrs_to_itrf(position[:1], position[:1], t_s[i : i + 1], VALLADO)[0][0] for i in range(97)]
    assert np.abs(at_once - np.array(alone)).max() < 1e-4


def test_offline_table_holds_the_published_orientation() -> None:
    found = orientation_at(WHEN)
    assert found.in_table
    assert abs(found.ut1_utc_s - VALLADO.ut1_utc_s) < 1e-3  # the example takes the day's value, not the hour's
    assert abs(found.pole_x_rad - VALLADO.pole_x_rad) < 5e-3 * ARCSEC_RAD
    assert abs(found.pole_y_rad - VALLADO.pole_y_rad) < 5e-3 * ARCSEC_RAD


def test_beyond_the_table_the_last_day_holds_and_is_told() -> None:
    assert not orientation_at(datetime(2090, 1, 1, tzinfo=UTC)).in_table


def test_a_leap_second_is_no_rotation() -> None:
    """2016-12-31 to 2017-01-01: UT1-UTC jumps by one second, UT1 does not."""
    noon = orientation_at(datetime(2016, 12, 31, 12, tzinfo=UTC))
    assert abs(noon.ut1_utc_s - -0.409) < 0.005


def test_sidereal_time_of_meeus() -> None:
    """Meeus, example 12.a: 1987 April 10, 0h UT: 13h 10m 46.3668s."""
    days = np.array([(datetime(1987, 4, 10) - datetime(2000, 1, 1, 12)).total_seconds() / 86400.0])
    hours = np.degrees(gmst82_rad(days))[0] / 15.0
    assert abs(hours - (13 + 10 / 60 + 46.3668 / 3600)) < 1e-7
