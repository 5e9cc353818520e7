"""Rescaled factors: Sigma becomes D Sigma D for every noise, and the type of the noise stays where it can."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Cauchy, Covariance, Diagonal, Information, Isotropic, Noise, Prior, Robust, SqrtInformation
from factors.noise import square
from factors.rescaled import rescaled
from models import SE2
from nls import kinds

(x,) = kinds("x")
S = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.002], [0.0, 0.002, 0.01]])
NOISES = [
    Isotropic(0.1),
    Isotropic([0.1, 0.2]),
    Diagonal([0.1, 0.2, 0.3]),
    Diagonal(yaw=0.3, x=[0.1, 0.4], y=0.2),
    Covariance(S),
    Information(np.stack([S, 2 * S])),
    Information(np.diag([1.0, 0.0, 4.0])),
    SqrtInformation(np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.5], [0.3, 0.0, 2.0]])),
    Robust(Covariance(S), Cauchy(2.0)),
]


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize(
    "scale", [np.full((1, 3), 3.0), np.array([[3.0, 3.0, 0.5], [1.0, 2.0, 4.0]])], ids=["one", "each"]
)
def test_the_information_is_that_of_scaled_errors(noise: Noise, scale: np.ndarray) -> None:
    model = Prior(x[[0, 1]], np.zeros((2, 3)), noise).bind(SE2)
    other = rescaled(model, scale)
    W, V = (np.broadcast_to(square(m.W), (2, 3, 3)) for m in (model, other.bind(SE2)))
    D_inv = 1 / np.broadcast_to(scale, (2, 3))
    assert V.mT @ V == pytest.approx(D_inv[:, :, None] * (W.mT @ W) * D_inv[:, None, :])
    assert other.kernel == model.factor.kernel
    assert (type(other.noise) is type(noise)) or isinstance(noise, Isotropic)
    assert model.factor.noise is noise
