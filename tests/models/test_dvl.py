"""The velocity of a DVL: numbers by hand, derivatives by differences, presets that are refused when they cannot be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from models import SE3
from models.errors import OptionError
from models.sensors.dvl import DVL, HOLOOCEAN_DVL, dvl_velocity
from tests.models.differences import difference, on_group

AFT_AND_TURNED = np.array([[-1.5, 0.2, 0.4, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]])  # its x to starboard


def test_by_hand() -> None:
    v, w = np.array([[1.0, 0.5, -0.2]]), np.array([[0.0, 0.0, 0.1]])
    v_d, _ = dvl_velocity(v, w, AFT_AND_TURNED)
    body = np.array([1.0 - 0.1 * 0.2, 0.5 - 0.1 * 1.5, -0.2])  # v + w x a
    np.testing.assert_allclose(v_d, [[body[1], -body[0], body[2]]], atol=1e-15)


def test_derivatives_and_one_mounting_for_all() -> None:
    rng = np.random.default_rng(5)
    v, w, O = rng.normal(size=(7, 3)), rng.normal(size=(7, 3)), SE3.exp(rng.normal(size=(7, 6)))
    _, (H_v, H_w, H_O) = dvl_velocity(v, w, O)
    np.testing.assert_allclose(H_O, on_group(SE3, lambda O: dvl_velocity(v, w, O)[0], O), atol=1e-8)
    np.testing.assert_allclose(H_v, difference(lambda v: dvl_velocity(v, w, O)[0], v), atol=1e-8)
    np.testing.assert_allclose(H_w, difference(lambda w: dvl_velocity(v, w, O)[0], w), atol=1e-8)
    one, each = (dvl_velocity(v, w, mount)[1] for mount in (AFT_AND_TURNED, np.repeat(AFT_AND_TURNED, 7, axis=0)))
    assert [H.shape for H in one] == [(7, 3, 3), (7, 3, 3), (7, 3, 6)]
    for a, b in zip(one, each, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_dvl_is_a_value_that_can_be() -> None:
    mounted = dataclasses.replace(HOLOOCEAN_DVL, mount=AFT_AND_TURNED[0])
    assert mounted == dataclasses.replace(HOLOOCEAN_DVL, mount=tuple(AFT_AND_TURNED[0]))
    assert len({mounted, HOLOOCEAN_DVL}) == 2
    for name, value in (
        *(("sigma", bad) for bad in (0.0, float("nan"), "a")),
        ("scale", -0.1),
        ("mount", (0.0, 0.0, 0.0)),
        ("mount", (0.0,) * 7),
    ):
        with pytest.raises(OptionError, match=f"{name}: "):
            DVL(**{"name": "mine", "sigma": 0.01, name: value})  # type: ignore[arg-type]
