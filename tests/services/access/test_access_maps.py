"""The coverage map shows the region asked for, over the dateline too."""

from __future__ import annotations

import numpy as np
import pytest

from services.access.maps import Covered, draw_map


@pytest.mark.parametrize(
    ("longitude_deg", "limits"),
    [
        ((170.0, 180.0, -170.0), (169.0, 191.0)),
        ((-120.0, -110.0, -100.0), (-121.0, -99.0)),
        ((-179.5, 0.0, 179.5), (-180.0, 180.0)),
    ],
)
def test_a_region_over_the_dateline_is_one(longitude_deg: tuple[float, ...], limits: tuple[float, float]) -> None:
    covered = Covered(
        np.array([-10.0, 0.0, 10.0]), np.array(longitude_deg), np.array([0, 1, 2], dtype=np.int32), "Cells"
    )
    figure = draw_map([], [], covered, "a title")
    assert figure.axes[1].get_xlim() == pytest.approx(limits)
    assert figure.axes[0].get_xlim() == (-180.0, 180.0)
    assert "66.7 % of 3" in figure.axes[1].get_title()
