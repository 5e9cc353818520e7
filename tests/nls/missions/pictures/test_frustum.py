"""The frustum: its corners are at the ends of window, fan and aperture, and arcs have one range and one azimuth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from models import SE3
from models.sensors import DIDSON_HIGH, range_azimuth
from nls.plot import frustum

SONAR = replace(DIDSON_HIGH, window=(1.0, 6.0))
POSE = SE3.exp(np.array([1.0, 2.0, 3.0, 0.1, -0.3, 0.5]))
POINTS = SE3.act(POSE[None], np.array([[4.0, 0.5, 0.2], [3.0, -0.4, -0.1], [4.0, 3.0, 0.0]]))


def test_frustum_and_arcs() -> None:
    axes = frustum(SONAR, POSE, POINTS).axes[0]
    assert axes.zaxis.get_inverted()
    rims, arcs = (c for c in axes.collections if isinstance(c, Line3DCollection))
    local = [SE3.act(SE3.inverse(POSE[None]), np.array(rim)) for rim in rims._segments3d]
    r = np.linalg.norm(np.concatenate(local[:4]), axis=1)
    np.testing.assert_allclose(r, 6.0)
    far = np.concatenate(local[:4])
    assert np.isclose(np.ptp(range_azimuth(far)[0][:, 1]), SONAR.fan)
    assert np.isclose(2 * np.arcsin(far[:, 2].max() / 6.0), SONAR.aperture)
    for arc, point in zip(arcs._segments3d, POINTS[:2], strict=True):  # the third is beside the fan
        both = SE3.act(SE3.inverse(POSE[None]), np.vstack([arc, point]))
        z, _ = range_azimuth(both)
        np.testing.assert_allclose(z, np.tile(z[-1], (len(z), 1)), atol=1e-12)
        assert np.linalg.norm(np.array(arc) - point, axis=1).min() < 0.03  # and passes through the point
    drawn = {line.get_label(): np.stack(line.get_data_3d(), axis=1) for line in axes.lines}
    np.testing.assert_allclose(drawn["out of view"], POINTS[2:])
    np.testing.assert_allclose(drawn["sonar"], POSE[None, :3])
