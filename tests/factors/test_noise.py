"""Noise models: every constructor whitens as the dense formula W'W = Sigma^-1, and refuses what is no noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import factors as f
from factors import Covariance, Diagonal, Factor, Huber, Information, Isotropic, Noise, Prior, Robust, SqrtInformation
from factors.noise import square, whiten
from factors.rescaled import rescaled
from models import SE2, SE3, R
from models.algebra import Array
from models.errors import GraphError, NoiseModelError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import linearized, refused, same

PLANE = ("x", "y", "yaw")
(x,) = kinds("x")


def names(m: int) -> tuple[str, ...]:
    return tuple(f"c{k}" for k in range(m))


def covariances(n: int, m: int, seed: int) -> Array:
    """Random positive definite matrices (n, m, m), of different scale in each component."""
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(n, m, m))
    scale = 10.0 ** rng.uniform(-2, 2, size=m)
    return scale[:, None] * (M @ M.mT + 0.1 * np.eye(m)) * scale


def information_of(noise: Noise, n: int, m: int) -> Array:
    """W'W (n, m, m), by whitening the identity and vectors as a factor does."""
    W = noise.sqrt_information(n, names(m))
    assert W.shape[0] in (1, n)
    assert W.shape[1:] in ((m,), (m, m))
    eye = np.broadcast_to(np.eye(m), (n, m, m))
    WJ = np.broadcast_to(whiten(W, eye), (n, m, m))
    for k in range(m):
        same(np.broadcast_to(whiten(W, eye[:, :, k]), (n, m)), WJ[:, :, k], rtol=1e-14)
    return WJ.mT @ WJ


def assert_information(noise: Noise, Sigma: Array, n: int) -> None:
    m = Sigma.shape[-1]
    scale = np.sqrt(np.diagonal(Sigma, axis1=-2, axis2=-1))
    found = information_of(noise, n, m) * scale[..., :, None] * scale[..., None, :]
    correlation = Sigma / scale[..., :, None] / scale[..., None, :]
    same(found, np.broadcast_to(np.linalg.inv(correlation), found.shape), rtol=1e-9, atol=1e-9)


@for_all(m=[1, 2, 3, 6, 7], n=[1, 5])
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_matrices_whiten_as_the_dense_formula(m: int, n: int, seed: int) -> None:
    Sigma = covariances(n, m, seed)
    L, Omega = np.linalg.cholesky(Sigma), np.linalg.inv(Sigma)
    Omega = (Omega + Omega.mT) / 2  # inv leaves an asymmetry of rounding
    for noise in (Covariance(Sigma), Information(Omega), SqrtInformation(np.linalg.inv(L))):
        assert_information(noise, Sigma, n)
    for noise in (Covariance(Sigma[0]), Covariance(Sigma[:1]), SqrtInformation(np.linalg.inv(L[0]))):
        assert_information(noise, Sigma[:1], n)


@for_all(n=[1, 5])
def test_sigmas_whiten_as_the_dense_formula(n: int) -> None:
    rng = np.random.default_rng(1)
    shared, each, per = rng.uniform(0.1, 10, 3), rng.uniform(0.1, 10, (n, 3)), rng.uniform(0.1, 10, n)
    named = np.stack([np.full(n, shared[0]), np.full(n, shared[1]), each[:, 2]], axis=1)
    for noise, sigmas in (
        (Diagonal(shared), shared[None]),
        (Diagonal(each), each),
        (Isotropic(0.3), np.full((1, 3), 0.3)),
        (Isotropic(per), np.tile(per[:, None], 3)),
        (Isotropic(), np.ones((1, 3))),
        (Diagonal(c1=shared[1], c2=each[:, 2], c0=shared[0]), named),
    ):
        assert_information(noise, sigmas[:, :, None] ** 2 * np.eye(3), n)


def test_semi_definite_information_says_nothing_in_some_directions() -> None:
    rng = np.random.default_rng(5)
    u, known = rng.normal(size=(3, 1)), covariances(1, 3, 6)[0]
    Omega = np.stack([u @ u.T, known, np.zeros((3, 3))])
    W = Information(Omega).sqrt_information(3, PLANE)
    same(W.mT @ W, Omega, rtol=1e-9, atol=1e-9 * np.abs(known).max())
    assert np.sum(np.abs(W).max(axis=2) < 1e-7 * np.abs(u).max(), axis=1).tolist() == [2, 0, 3]
    W = Information(Omega[0]).sqrt_information(1, PLANE)
    same(W.mT @ W, Omega[:1], rtol=1e-9, atol=1e-9)
    e = rng.normal(size=(3, 3))
    (A,), b = linearized(Prior(x[0:3], e, Information(Omega)), Values({x: (R(3), np.zeros((3, 3)))}))
    assert np.isfinite(A).all()
    expected = [e[k] @ Omega[k] @ e[k] for k in range(3)]
    assert np.sum(b**2, axis=1) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    same(Information(np.diag([4.0, 0.0, 9.0])).sqrt_information(1, PLANE), [[2.0, 0.0, 3.0]], atol=0)
    u = np.array([[1.0], [2.0], [3.0]])
    W = Information(u @ u.T - 1e-12 * np.eye(3)).sqrt_information(1, PLANE)  # rounded: no error
    same(W[0].T @ W[0], u @ u.T, atol=1e-9)


def whitened(noise: Noise, n: int = 2, names: tuple[str, ...] = ("x", "y")) -> Array:
    return noise.sqrt_information(n, names)


def test_negative_information_names_its_measurement() -> None:
    Omega = np.tile(GOOD, (4, 1, 1))
    Omega[2] = [[1.0, 2.0], [2.0, 1.0]]
    named = "measurement 2 has the negative eigenvalue -1: .*1 such"
    caught = refused(lambda: Information(Omega), NoiseModelError, named)
    assert (caught.matrix, caught.index) == ("information", 2)
    assert caught.value == pytest.approx(-1.0)
    refused(lambda: Information(np.diag([4.0, -4.0])), NoiseModelError, "0 has the negative eigenvalue -4")


GOOD = np.array([[2.0, 0.5], [0.5, 1.0]])


def test_matrices_that_are_no_noise_name_their_measurement() -> None:
    skew = [GOOD, [[2.0, 0.5], [0.4, 1.0]]]
    for kind, matrix, named, index, value in (
        (Covariance, [GOOD, [[1.0, 2.0], [2.0, 1.0]]], "Covariance of measurement 1", 1, -1.0),
        (Covariance, [GOOD, np.ones((2, 2))], "Covariance of measurement 1", 1, 0.0),
        (Covariance, np.diag([1.0, 0.0]), "Covariance of component 1, measurement 0, is 0,", 0, 0.0),
        (Covariance, np.diag([1.0, -2.0]), "Covariance of component 1, measurement 0, is -2,", 0, -2.0),
        (Covariance, [[-0.1]], "Covariance of measurement 0 is -0.1,", 0, -0.1),
        (Covariance, skew, "Covariance of measurement 1 is not symmetric", 1, 0.1),
        (Information, skew, "Information of measurement 1 is not symmetric", 1, 0.1),
    ):
        caught = refused(lambda kind=kind, matrix=matrix: kind(matrix), NoiseModelError, named)
        assert caught.index == index
        assert caught.value == pytest.approx(value, abs=1e-12)
    whitened(SqrtInformation([[2.0, 0.5], [0.0, 1.0]]))
    for kind in (Covariance, Information, SqrtInformation):
        for bad in (0.1, [0.1, 0.2], np.ones((2, 3)), np.ones((4, 2, 3))):
            refused(lambda k=kind, bad=bad: k(bad), NoiseModelError, rf"{kind.__name__}: .*\(m, m\) or \(n, m, m\)")
        refused(lambda k=kind: k(np.ones((1, 1, 2, 2))), NoiseModelError, "at most 3")
    refused(lambda: Isotropic([[0.1]]), NoiseModelError, "at most 1")


@for_all(bad=[np.nan, np.inf])
def test_numbers_must_be_finite_and_the_measurement_is_named(bad: float) -> None:
    eye = np.eye(2)
    broken = np.array([[1.0, 0.0], [0.0, bad]])
    for make, k in (
        (lambda: Isotropic(bad), 0),
        (lambda: Isotropic([0.1, bad]), 1),
        (lambda: Diagonal([0.1, 0.2, bad]), 0),
        (lambda: Diagonal([[0.1, 0.2], [0.1, bad]]), 1),
        (lambda: Diagonal(x=0.1, y=[0.1, 0.1, bad]), 2),
        (lambda: Covariance(broken), 0),
        (lambda: Information([eye, eye, broken]), 2),
        (lambda: SqrtInformation([eye, broken]), 1),
    ):
        assert refused(make, NoiseModelError, f"of measurement {k} .* not finite").index == k


@for_all(bad=[0.0, -0.1])
def test_sigmas_must_be_positive(bad: float) -> None:
    for make, place, k in (
        (lambda: Isotropic(bad), "measurement 0", 0),
        (lambda: Isotropic([0.1, bad]), "measurement 1", 1),
        (lambda: Diagonal([0.1, bad, 0.1]), "component 1, measurement 0,", 0),
        (lambda: Diagonal([[0.1, 0.1, 0.1], [0.1, 0.1, bad]]), "component 2, measurement 1,", 1),
        (lambda: Diagonal(x=0.1, yaw=0.1, y=[0.1, bad]), "y, measurement 1,", 1),
        (lambda: Diagonal(theta=bad), "yaw, measurement 0,", 0),
    ):
        caught = refused(make, NoiseModelError, rf"^sigma of {place} is {bad:g}, expected > 0$")
        assert (caught.index, caught.value) == (k, bad)


def test_a_noise_shows_its_numbers() -> None:
    many, eye = np.linspace(0.1, 0.3, 500), np.eye(6)
    for noise, shown in (
        (Isotropic(0.1), "Isotropic(0.1)"),
        (Isotropic(many), "Isotropic(500 of them, 0.1 to 0.3)"),
        (Diagonal([0.1, 1e-05, 1 / 3]), "Diagonal([0.1, 1e-05, 0.333333])"),
        (Diagonal(x=0.1, theta=many, y=[0.1, 0.2]), "Diagonal(x=0.1, yaw=500 of them, 0.1 to 0.3, y=[0.1, 0.2])"),
        (Diagonal(np.full((500, 3), 0.2)), "Diagonal(500 x 3 of them, 0.2)"),
        (Covariance([[4.0, 1.0], [1.0, 9.0]]), "Covariance([[4, 1], [1, 9]])"),
        (Covariance(eye), "Covariance(6 x 6, diagonal 1)"),
        (Information(many[:, None, None] * eye), "Information(500 x 6 x 6, diagonal 0.1 to 0.3)"),
        (SqrtInformation([[2.0]]), "SqrtInformation([[2]])"),
        (Robust(Diagonal(x=0.1, y=0.2), Huber(1.345)), "Robust(Diagonal(x=0.1, y=0.2), Huber(1.345))"),
    ):
        assert repr(noise) == shown
    assert Diagonal(x=0.1, theta=0.2).named["yaw"] == 0.2
    assert Diagonal(depth=0.1).sqrt_information(1, ("depth",)).tolist() == [[10.0]]
    assert repr(Prior(x[0], [0.0], Isotropic(0.1))) == "Prior(x0)", "messages name a factor without its numbers"


def test_noise_of_the_wrong_shape() -> None:
    for noise, named in (
        (Isotropic([0.1, 0.1]), "sigma: given for 2 measurements, there are 3"),
        (Diagonal([0.1, 0.1]), r"Diagonal: 2 sigmas .* 3 components \('x', 'y', 'yaw'\)"),
        (Diagonal(np.ones((2, 3))), "sigmas: given for 2 measurements, there are 3"),
        (Diagonal(x=0.1, y=0.1), r"\['x', 'y'\], .*\['x', 'y', 'yaw'\]"),
        (Diagonal(x=0.1, y=0.1, roll=0.1), r"\['roll', 'x', 'y'\]"),
        (Diagonal(x=[0.1, 0.1], y=0.1, yaw=0.1), "sigma of x: given for 2 measurements, there are 3"),
        (Covariance(np.eye(2)), "Covariance: 2 x 2, .* 3 components"),
        (Information(np.eye(6)), "Information: 6 x 6, .* 3 components"),
        (SqrtInformation(np.tile(np.eye(3), (2, 1, 1))), "SqrtInformation: given for 2 measurements, there are 3"),
    ):
        refused(lambda noise=noise: whitened(noise, 3, PLANE), NoiseModelError, named)


def test_numbers_too_extreme_name_the_measurement() -> None:
    """A sigma without an inverse, an information that is 0, a residual of too many sigmas."""
    values = Values({x: (R(2), np.zeros((3, 2)))})

    def prior(noise: Noise, n: int = 2, z: object = (0.0, 0.0)) -> Prior:
        return Prior(x[0:n], z, noise)

    caught = refused(lambda: values.gather(prior(Isotropic([1.0, 1e-320]))), NoiseModelError, r"Prior\(x1\): .*ment 1 ")
    assert caught.index == 1
    for noise in (
        Isotropic([1.0, 1e160]),
        Diagonal([[1.0, 1.0], [1.0, 1e160]]),
        Information([np.eye(2), 1e-320 * np.eye(2)]),
    ):
        model, _ = values.gather(prior(noise))
        assert refused(model.refuse_extreme, NoiseModelError, r"Prior\(x1\): sigma 1e\+160 of .").index == 1
    for measured, sigma in ((1e160, 1.0), (1.0, 1e-153), (1e200, 1e40)):
        model, _ = values.gather(prior(Isotropic([1, sigma, 1]), 3, [[1, 1], [1, measured], [1, 1]]))
        caught = refused(model.refuse_extreme, GraphError, r"Prior\(x1\): .*\[1\.0, .*\] has .* sigmas")
        assert (caught.index, [repr(key) for key in caught.keys]) == (1, ["x1"])


def test_sigmas_go_to_the_component_they_name() -> None:
    space = SE3.components
    W = Diagonal(yaw=0.5, pitch=0.25, roll=0.2, z=0.1, y=2.0, x=1.0).sqrt_information(1, space)
    same(W, [[1.0, 0.5, 10.0, 5.0, 4.0, 2.0]])
    other = Diagonal(rz=0.5, ry=0.25, rx=0.2, depth=0.1, y=2.0, x=1.0).sqrt_information(1, space)
    np.testing.assert_array_equal(other, W)
    for alias in ("yaw", "theta", "heading", "h", "rz"):
        W = Diagonal(**{alias: 0.5, "x": 0.1, "y": 0.2}).sqrt_information(1, PLANE)
        same(W, [[10.0, 5.0, 2.0]])


def test_named_sigmas_are_given_once() -> None:
    refused(lambda: Diagonal(x=0.1, y=0.1, theta=0.1, yaw=0.2), NoiseModelError, "twice")
    refused(lambda: Diagonal([0.1], x=0.1), NoiseModelError, "not both")
    refused(Diagonal, NoiseModelError, "give the sigmas")


def test_the_caller_may_change_arrays_afterwards() -> None:
    Sigma, sigmas = np.eye(2), np.ones(2)
    noise, other = Covariance(Sigma), Diagonal(sigmas)
    Sigma[:], sigmas[:] = 100.0, 100.0
    np.testing.assert_array_equal(noise.sqrt_information(1, ("x", "y")), [[1.0, 1.0]])
    np.testing.assert_array_equal(other.sqrt_information(1, ("x", "y")), [[1.0, 1.0]])


def test_the_size_of_a_noise_may_wait_for_the_variables() -> None:
    """Four numbers are a quaternion or a vector; three numbers of three variables may be one for each."""
    for m in (3, 4):
        assert len(Prior(x[0], [0.0, 0.0, 0.0, 1.0], Covariance(np.eye(m)))) == 1
    either = Prior(x[0:3], np.zeros(3), Diagonal([1.0, 1.0]))
    names = ("x", "yaw")
    assert Prior(x[0], np.zeros(3), Diagonal([1.0, 1.0]), names).bind(SE2).W.shape == (1, 2)
    for make, named in (
        (lambda: Prior(x[0], [0.0, 0.0, 0.0, 1.0], Covariance(np.eye(5))), "for 5 numbers, expected 3 or 4"),
        (lambda: Prior(x[0], np.zeros(3), Diagonal([1.0, 1.0, 1.0]), names), "for 3 numbers, expected 2"),
        (
            lambda: Factor.from_function(np.array, x[0], 2, Diagonal([1.0] * 3)),
            r"array\(x0\): .* 3 numbers, expected 2",
        ),
        (lambda: either.bind(R(1)), "2 sigmas"),
        (lambda: either.bind(SE2), "2 sigmas"),
    ):
        refused(make, NoiseModelError, named)


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
    Robust(Covariance(S), f.Cauchy(2.0)),
]


@for_all(noise=NOISES, scale=[np.full((1, 3), 3.0), np.array([[3.0, 3.0, 0.5], [1.0, 2.0, 4.0]])])
def test_the_information_is_that_of_scaled_errors(noise: Noise, scale: Array) -> None:
    """Sigma becomes D Sigma D, and the type of the noise stays where it can."""
    model = Prior(x[[0, 1]], np.zeros((2, 3)), noise).bind(SE2)
    other = rescaled(model, scale)
    W, V = (np.broadcast_to(square(m.W), (2, 3, 3)) for m in (model, other.bind(SE2)))
    D_inv = 1 / np.broadcast_to(scale, (2, 3))
    assert V.mT @ V == pytest.approx(D_inv[:, :, None] * (W.mT @ W) * D_inv[:, None, :])
    assert other.kernel == model.factor.kernel
    assert (type(other.noise) is type(noise)) or isinstance(noise, Isotropic)
    assert model.factor.noise is noise
