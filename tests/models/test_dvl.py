"""The velocity of a DVL: numbers by hand, derivatives by differences, presets that are refused when they cannot be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from models import SE3
from models.errors import OptionError
from models.sensors.dvl import DVL, HOLOOCEAN_DVL, dvl_velocity

AFT_AND_TURNED = np.array([[-1.5, 0.2, 0.4, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]])  # its x to starboard


def test_by_hand() -> None:
    v, w = np.array([[1.0, 0.5, -0.2]]), np.array([[0.0, 0.0, 0.1]])
    v_d, _ = dvl_velocity(v, w, AFT_AND_TURNED)
    body = np.array([1.0 - 0.1 * 0.2, 0.5 - 0.1 * 1.5, -0.2])  # v + w x a
    np.testing.assert_allclose(v_d, [[body[1], -body[0], body[2]]], atol=1e-15)


def test_derivatives() -> None:
    rng = np.random.default_rng(5)
    v, w, O = rng.normal(size=(7, 3)), rng.normal(size=(7, 3)), SE3.exp(rng.normal(size=(7, 6)))
    _, (H_v, H_w, H_O) = dvl_velocity(v, w, O)
    assert H_v.shape == H_w.shape == (7, 3, 3)
    assert H_O.shape == (7, 3, 6)
    h = 1e-6
    for c, e in enumerate(np.eye(6)):
        ahead, back = (dvl_velocity(v, w, SE3.retract(O, np.tile(s * h * e, (7, 1))))[0] for s in (1, -1))
        np.testing.assert_allclose(H_O[..., c], (ahead - back) / (2 * h), atol=1e-8)
        if c < 3:
            step = h * e[:3]
            by_v = dvl_velocity(v + step, w, O)[0] - dvl_velocity(v - step, w, O)[0]
            by_w = dvl_velocity(v, w + step, O)[0] - dvl_velocity(v, w - step, O)[0]
            np.testing.assert_allclose(H_v[..., c], by_v / (2 * h), atol=1e-8)
            np.testing.assert_allclose(H_w[..., c], by_w / (2 * h), atol=1e-8)


def test_one_mounting_serves_all() -> None:
    rng = np.random.default_rng(6)
    v, w = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    _, one = dvl_velocity(v, w, AFT_AND_TURNED)
    assert [H.shape for H in one] == [(4, 3, 3), (4, 3, 3), (4, 3, 6)]
    _, each = dvl_velocity(v, w, np.repeat(AFT_AND_TURNED, 4, axis=0))
    for a, b in zip(one, each, strict=True):
        np.testing.assert_array_equal(np.broadcast_to(a, b.shape), b)


def test_a_dvl_is_a_value() -> None:
    mounted = dataclasses.replace(HOLOOCEAN_DVL, mount=AFT_AND_TURNED[0])
    assert mounted == dataclasses.replace(HOLOOCEAN_DVL, mount=tuple(AFT_AND_TURNED[0]))
    assert mounted != HOLOOCEAN_DVL
    assert len({mounted, HOLOOCEAN_DVL}) == 2


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sigma": 0.0}, r"sigma: 0\.0 is not possible; expected a standard deviation above 0"),
        ({"sigma": float("nan")}, "sigma: nan"),
        ({"sigma": "a"}, "sigma: 'a' is not"),
        ({"scale": -0.1}, r"scale: -0\.1 is not possible; expected a fraction"),
        ({"mount": (0.0, 0.0, 0.0)}, "mount: .* expected a pose x y z qx qy qz qw"),
        ({"mount": (0.0,) * 7}, "mount: .* quaternion of length 1"),
    ],
)
def test_what_cannot_be(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        DVL(**{"name": "mine", "sigma": 0.01, **wrong})  # type: ignore[arg-type]
