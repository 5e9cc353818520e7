"""A noise for other measurements or numbers than a factor has is refused by the line that makes the factor."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Covariance, Diagonal, Factor, Huber, Information, Isotropic, Noise, Prior, Robust, SqrtInformation
from models import SE2, R
from models.errors import NoiseModelError
from nls import kinds
from tests.factors.samples import Sample
from tests.factors.test_conformity import SAMPLES, situation

(x,) = kinds("x")


def sized(n: int, m: int) -> list[Noise]:
    """Noises for n measurements of m numbers each; n = 1: for all."""
    square = np.tile(np.eye(m), (n, 1, 1))
    noises: list[Noise] = [kind(square) for kind in (Covariance, Information, SqrtInformation)]
    noises += [Diagonal(np.ones((n, m))), Diagonal(**{f"c{k}": np.ones(n) for k in range(m)})]
    return [*noises, *(Robust(noise, Huber(1.0)) for noise in noises)]


NOISY = [sample for sample in SAMPLES if not sample.name.startswith("ElevationHinge")]  # which takes none


@pytest.mark.parametrize("sample", NOISY, ids=str)
def test_of_every_factor_when_it_is_made(sample: Sample) -> None:
    for n in (1, 4):
        z = situation(sample, "truth", n, 0)[1]
        m = sample.dim
        for count in (1, n):
            for noise in (Covariance(np.tile(np.eye(m), (count, 1, 1))), Diagonal(np.ones((count, m)))):
                assert len(sample.factor(z, noise)) == n
        for noise in (*sized(n + 1, m), Isotropic(np.ones(n + 1)), Robust(Isotropic(np.ones(n + 2)), Huber(1.0))):
            with pytest.raises(NoiseModelError, match="measurements, there are"):
                sample.factor(z, noise)
        for other in (m + 1 + (z.shape[1] > m), m + 3):  # a quaternion may be a vector of four numbers
            for noise in sized(1, other):
                with pytest.raises(NoiseModelError, match=rf"for {other} numbers, expected {m}"):
                    sample.factor(z, noise)


def test_what_is_not_known_yet_waits_for_the_variables() -> None:
    """Four numbers are a quaternion or a vector; three numbers of three variables may be one for each."""
    for m in (3, 4):
        assert len(Prior(x[0], [0.0, 0.0, 0.0, 1.0], Covariance(np.eye(m)))) == 1
    with pytest.raises(NoiseModelError, match="for 5 numbers, expected 3 or 4"):
        Prior(x[0], [0.0, 0.0, 0.0, 1.0], Covariance(np.eye(5)))
    either = Prior(x[0:3], np.zeros(3), Diagonal([1.0, 1.0]))
    for manifold in (R(1), SE2):
        with pytest.raises(NoiseModelError, match="2 sigmas"):
            either.bind(manifold)
    some = Prior(x[0], np.zeros(3), Diagonal([1.0, 1.0]), components=("x", "yaw"))
    assert some.bind(SE2).W.shape == (1, 2)
    with pytest.raises(NoiseModelError, match="for 3 numbers, expected 2"):
        Prior(x[0], np.zeros(3), Diagonal([1.0, 1.0, 1.0]), components=("x", "yaw"))


def test_numbers_of_a_function() -> None:
    with pytest.raises(NoiseModelError, match=r"flat\(x0\): Diagonal\(\[1, 1, 1\]\): for 3 numbers, expected 2"):
        Factor.from_function(flat, x[0], 2, Diagonal([1.0, 1.0, 1.0]))


def flat(X: np.ndarray) -> np.ndarray:
    return X[:, :2]
