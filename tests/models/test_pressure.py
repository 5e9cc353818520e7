"""Depth from pressure: the check value of the source, TEOS-10, and a column of water."""

from __future__ import annotations

import numpy as np
import pytest

from models.errors import LeadlineError
from models.pressure import GRAVITY, depth_by_density, depth_unesco


def test_the_check_value_of_the_source() -> None:
    assert float(depth_unesco(1e8, 30.0)) == pytest.approx(9712.653, abs=5e-4)


def test_teos_10_has_the_same_but_for_a_hundredth_of_a_percent() -> None:
    gsw = pytest.importorskip("gsw")
    for latitude in (-60.0, 0.0, 45.0):
        for dbar, most in ((10.0, 3e-6), (1000.0, 3e-6), (10000.0, 1.3e-4)):
            assert float(depth_unesco(dbar * 1e4, latitude)) == pytest.approx(-gsw.z_from_p(dbar, latitude), rel=most)


def test_a_column_of_water_weighs_its_pressure() -> None:
    assert float(depth_by_density(1025.0 * GRAVITY * 37.0, 1025.0)) == pytest.approx(37.0)
    assert float(depth_by_density(0.0, 1025.0)) == 0.0
    for density in (0.0, -1.0, np.nan, "sea"):
        with pytest.raises(LeadlineError, match="density"):
            depth_by_density(1e5, density)  # type: ignore[arg-type]
    with pytest.raises(LeadlineError, match="latitude"):
        depth_unesco(1e5, 91.0)
