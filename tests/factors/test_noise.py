"""Noise models: every constructor whitens as the dense formula W'W = Sigma^-1, and refuses what is no noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors import Between, Covariance, Diagonal, Information, Isotropic, Noise, Prior, SqrtInformation
from factors.noise import whiten
from models import SE2, SE3, R
from models.errors import GraphError, NoiseModelError
from nls import Values, kinds

Array = npt.NDArray[np.float64]
PLANE = ("x", "y", "yaw")


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
        np.testing.assert_allclose(np.broadcast_to(whiten(W, eye[:, :, k]), (n, m)), WJ[:, :, k], rtol=1e-14)
    return WJ.mT @ WJ


def assert_information(noise: Noise, Sigma: Array, n: int) -> None:
    m = Sigma.shape[-1]
    scale = np.sqrt(np.diagonal(Sigma, axis1=-2, axis2=-1))
    found = information_of(noise, n, m) * scale[..., :, None] * scale[..., None, :]
    correlation = Sigma / scale[..., :, None] / scale[..., None, :]
    np.testing.assert_allclose(found, np.broadcast_to(np.linalg.inv(correlation), found.shape), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("m", [1, 2, 3, 6, 7])
@pytest.mark.parametrize("n", [1, 5])
@given(seed=st.integers(0, 2**32 - 1))
def test_matrices_whiten_as_the_dense_formula(m: int, n: int, seed: int) -> None:
    Sigma = covariances(n, m, seed)
    L = np.linalg.cholesky(Sigma)
    for noise in (Covariance(Sigma), Information(np.linalg.inv(Sigma)), SqrtInformation(np.linalg.inv(L))):
        if isinstance(noise, Information):
            noise.matrix = (noise.matrix + noise.matrix.mT) / 2  # inv leaves an asymmetry of rounding
        assert_information(noise, Sigma, n)
    shared = Sigma[:1]
    for noise in (Covariance(shared[0]), Covariance(shared), SqrtInformation(np.linalg.inv(L[0]))):
        assert_information(noise, shared, n)


@pytest.mark.parametrize("n", [1, 5])
def test_sigmas_whiten_as_the_dense_formula(n: int) -> None:
    rng = np.random.default_rng(1)
    shared, each = rng.uniform(0.1, 10, 3), rng.uniform(0.1, 10, (n, 3))
    one, per = 0.3, rng.uniform(0.1, 10, n)
    assert_information(Diagonal(shared), np.diag(shared**2)[None], n)
    assert_information(Diagonal(each), each[:, :, None] ** 2 * np.eye(3), n)
    assert_information(Isotropic(one), 0.09 * np.eye(3)[None], n)
    assert_information(Isotropic(per), per[:, None, None] ** 2 * np.eye(3), n)
    assert_information(Isotropic(), np.eye(3)[None], n)
    named = Diagonal(c1=shared[1], c2=each[:, 2], c0=shared[0])
    expected = np.stack([np.full(n, shared[0]), np.full(n, shared[1]), each[:, 2]], axis=1)
    assert_information(named, expected[:, :, None] ** 2 * np.eye(3), n)


@pytest.mark.parametrize("n", [1, 4])
def test_constructors_agree(n: int) -> None:
    """The same knowledge said in every way gives the same chi2 and the same A'A of a factor."""
    sigmas = np.array([0.1, 0.2, 0.05])
    said = [
        Diagonal(sigmas),
        Diagonal(np.tile(sigmas, (n, 1))),
        Diagonal(x=0.1, y=0.2, yaw=0.05),
        Covariance(np.diag(sigmas**2)),
        Covariance(np.tile(np.diag(sigmas**2), (n, 1, 1))),
        Information(np.diag(sigmas**-2)),
        Information(np.tile(np.diag(sigmas**-2), (n, 1, 1))),
        SqrtInformation(np.diag(1 / sigmas)),
        SqrtInformation(np.diag([-1.0, 1.0, -1.0]) / sigmas),
    ]
    assert_agree(said, n)
    Sigma = covariances(1, 3, 2)[0]
    Omega = np.linalg.inv(Sigma)
    Omega = (Omega + Omega.T) / 2
    said = [Covariance(Sigma), Information(Omega), SqrtInformation(np.linalg.cholesky(Omega).T)]
    said += [SqrtInformation(np.linalg.inv(np.linalg.cholesky(Sigma))), Covariance(np.tile(Sigma, (n, 1, 1)))]
    assert_agree(said, n)
    assert_agree([Isotropic(0.3), Diagonal([0.3] * 3), Isotropic([0.3] * n), Covariance(0.09 * np.eye(3))], n)


def assert_agree(said: list[Noise], n: int) -> None:
    x, y = kinds("x", "y")
    rng = np.random.default_rng(3)
    values = Values({x: (SE2, rng.normal(size=(n, 3))), y: (SE2, rng.normal(size=(n, 3)))})
    z = rng.normal(size=(n, 3))
    found = []
    for noise in said:
        model, X = values.gather(Between(x[0:n], y[0:n], z, noise))
        (A, _), b = model.linearize(*X)
        found.append((np.sum(b**2, axis=1), A.mT @ A))
    for other in found[1:]:
        np.testing.assert_allclose(other[0], found[0][0], rtol=1e-10)
        np.testing.assert_allclose(other[1], found[0][1], rtol=1e-9, atol=1e-9 * np.abs(found[0][1]).max())


def test_each_measurement_has_its_own_noise() -> None:
    (x,) = kinds("x")
    Sigma = covariances(3, 3, 4)
    e = np.random.default_rng(4).normal(size=(3, 3))
    model, X = Values({x: (R(3), np.zeros((3, 3)))}).gather(Prior(x[0:3], e, Covariance(Sigma)))
    expected = [e[k] @ np.linalg.inv(Sigma[k]) @ e[k] for k in range(3)]
    assert np.sum(model.error(*X) ** 2, axis=1) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("n", [1, 3])
def test_semi_definite_information_says_nothing_in_some_directions(n: int) -> None:
    rng = np.random.default_rng(5)
    u = rng.normal(size=(3, 1))
    known, singular = covariances(1, 3, 6)[0], u @ u.T
    Omega = np.stack([singular, known, np.zeros((3, 3))])[:n]
    W = Information(Omega).sqrt_information(n, PLANE)
    np.testing.assert_allclose(W.mT @ W, Omega, rtol=1e-9, atol=1e-9 * np.abs(known).max())
    zero_rows = np.sum(np.abs(W).max(axis=2) < 1e-7 * np.abs(u).max(), axis=1)
    assert zero_rows.tolist() == [2, 0, 3][:n]
    (x,) = kinds("x")
    e = rng.normal(size=(n, 3))
    model, X = Values({x: (R(3), np.zeros((n, 3)))}).gather(Prior(x[0:n], e, Information(Omega)))
    (A,), b = model.linearize(*X)
    assert np.isfinite(A).all()
    expected = [e[k] @ Omega[k] @ e[k] for k in range(n)]
    assert np.sum(b**2, axis=1) == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_diagonal_information_may_have_zeros() -> None:
    W = Information(np.diag([4.0, 0.0, 9.0])).sqrt_information(1, PLANE)
    np.testing.assert_array_equal(W, [[2.0, 0.0, 3.0]])
    with pytest.raises(NoiseModelError, match="measurement 0 has the negative eigenvalue -4"):
        Information(np.diag([4.0, -4.0, 9.0])).sqrt_information(1, PLANE)


def test_rounded_semi_definite_information_is_no_error() -> None:
    u = np.array([[1.0], [2.0], [3.0]])
    Omega = u @ u.T - 1e-12 * np.eye(3)
    W = Information(Omega).sqrt_information(1, PLANE)
    np.testing.assert_allclose(W[0].T @ W[0], u @ u.T, atol=1e-9)


def test_units_may_differ_by_any_factor() -> None:
    Sigma = np.array([[1e6, 0.1], [0.1, 1e-6]])  # 1 km, 1 mm, correlation 0.1
    assert_information(Covariance(Sigma), Sigma[None], 1)
    Omega = np.linalg.inv(Sigma)
    assert_information(Information((Omega + Omega.T) / 2), Sigma[None], 1)


def test_negative_information_names_its_measurement() -> None:
    Omega = np.tile(np.array([[2.0, 0.5], [0.5, 1.0]]), (4, 1, 1))
    Omega[2] = [[1.0, 2.0], [2.0, 1.0]]
    noise = Information(Omega)
    message = r"information of measurement 2 has the negative eigenvalue -1: .*1 such in this batch"
    with pytest.raises(NoiseModelError, match=message) as alone:
        noise.sqrt_information(4, ("x", "y"))
    (x,) = kinds("x")
    values = Values({x: (R(2), np.zeros((9, 2)))})
    with pytest.raises(NoiseModelError, match=r"Prior\(x7\): " + message) as bound:
        values.gather(Prior(x[5:9], np.zeros((4, 2)), noise))
    assert bound.value.keys == (x[5:9],)
    for error in (alone.value, bound.value):
        assert (error.matrix, error.index) == ("information", 2)
        assert error.value == pytest.approx(-1.0)


def test_covariance_must_be_positive_definite() -> None:
    good = np.array([[2.0, 0.5], [0.5, 1.0]])
    for bad, value in (([[1.0, 2.0], [2.0, 1.0]], -1.0), ([[1.0, 1.0], [1.0, 1.0]], 0.0)):
        with pytest.raises(NoiseModelError, match="Covariance of measurement 1 is not positive definite") as caught:
            Covariance([good, bad]).sqrt_information(2, ("x", "y"))
        assert caught.value.value == pytest.approx(value, abs=1e-12)
        assert caught.value.index == 1
    for entry in (0.0, -2.0):
        with pytest.raises(NoiseModelError, match=rf"Covariance of y, measurement 0, is {entry:g}, expected > 0"):
            Covariance([[1.0, 0.0], [0.0, entry]]).sqrt_information(1, ("x", "y"))


@pytest.mark.parametrize("kind", [Covariance, Information])
def test_matrices_must_be_symmetric(kind: type[Covariance | Information]) -> None:
    good = np.array([[2.0, 0.5], [0.5, 1.0]])
    with pytest.raises(NoiseModelError, match=rf"{kind.__name__} of measurement 1 is not symmetric") as caught:
        kind([good, [[2.0, 0.5], [0.4, 1.0]]]).sqrt_information(2, ("x", "y"))
    assert caught.value.index == 1
    SqrtInformation([[2.0, 0.5], [0.0, 1.0]]).sqrt_information(1, ("x", "y"))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
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
        with pytest.raises(NoiseModelError, match=f"of measurement {k} has a number that is not finite") as caught:
            make()
        assert caught.value.index == k


@pytest.mark.parametrize("bad", [0.0, -0.1])
def test_sigmas_must_be_positive(bad: float) -> None:
    for noise, name, k in (
        (Isotropic(bad), "x", 0),
        (Isotropic([0.1, bad]), "x", 1),
        (Diagonal([0.1, bad, 0.1]), "y", 0),
        (Diagonal([[0.1, 0.1, 0.1], [0.1, 0.1, bad]]), "yaw", 1),
        (Diagonal(x=0.1, yaw=0.1, y=[0.1, bad]), "y", 1),
    ):
        message = rf"sigma of {name}, measurement {k}, is {bad:g}, expected > 0"
        with pytest.raises(NoiseModelError, match=message) as caught:
            noise.sqrt_information(2, PLANE)
        assert (caught.value.index, caught.value.value) == (k, bad)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (Isotropic([0.1, 0.1]), r"sigma: given for 2 measurements, there are 3; give one, or 3"),
        (Diagonal([0.1, 0.1]), r"Diagonal: 2 sigmas for a measurement of 3 components \('x', 'y', 'yaw'\)"),
        (Diagonal(np.ones((2, 3))), r"sigmas: given for 2 measurements, there are 3"),
        (Diagonal(x=0.1, y=0.1), r"sigmas are given for \['x', 'y'\], .* components are \['x', 'y', 'yaw'\]"),
        (Diagonal(x=0.1, y=0.1, roll=0.1), r"sigmas are given for \['roll', 'x', 'y'\]"),
        (Diagonal(x=[0.1, 0.1], y=0.1, yaw=0.1), r"sigma of x: given for 2 measurements, there are 3"),
        (Covariance(np.eye(2)), r"Covariance: 2 x 2, the measurement has 3 components"),
        (Information(np.eye(6)), r"Information: 6 x 6, the measurement has 3 components"),
        (SqrtInformation(np.tile(np.eye(3), (2, 1, 1))), r"SqrtInformation: given for 2 measurements, there are 3"),
    ],
)
def test_noise_of_the_wrong_shape(noise: Noise, message: str) -> None:
    with pytest.raises(NoiseModelError, match=message):
        noise.sqrt_information(3, PLANE)


def test_a_sigma_too_small_for_its_inverse_names_the_measurement() -> None:
    (x,) = kinds("x")
    values = Values({x: (R(2), np.zeros((2, 2)))})
    with pytest.raises(NoiseModelError, match=r"Prior\(x1\): .* measurement 1 is beyond the largest number") as caught:
        values.gather(Prior(x[0:2], np.zeros(2), Isotropic([1.0, 1e-320])))
    assert caught.value.index == 1


@pytest.mark.parametrize(
    "noise",
    [
        Isotropic([1.0, 1e160]),
        Diagonal(np.array([[1.0, 1.0], [1.0, 1e160]])),
        Information([np.eye(2), 1e-320 * np.eye(2)]),
    ],
)
def test_an_information_too_small_for_a_number_names_the_measurement(noise: Noise) -> None:
    (x,) = kinds("x")
    values = Values({x: (R(2), np.zeros((2, 2)))})
    model, _ = values.gather(Prior(x[0:2], np.zeros(2), noise))
    said = r"Prior\(x1\): sigma 1e\+160 of . has an information too small for a number"
    with pytest.raises(NoiseModelError, match=said) as caught:
        model.refuse_extreme()
    assert caught.value.index == 1


@pytest.mark.parametrize(("measured", "sigma"), [(1e160, 1.0), (1.0, 1e-153), (1e200, 1e40)])
def test_a_measurement_of_too_many_sigmas_is_named(measured: float, sigma: float) -> None:
    (x,) = kinds("x")
    values = Values({x: (R(2), np.zeros((3, 2)))})
    z = [[1.0, 1.0], [1.0, measured], [1.0, 1.0]]
    model, _ = values.gather(Prior(x[0:3], z, Isotropic([1.0, sigma, 1.0])))
    said = r"Prior\(x1\): its measurement \[1\.0, .*\] has .* sigmas, too many"
    with pytest.raises(GraphError, match=said) as caught:
        model.refuse_extreme()
    assert (caught.value.index, [repr(key) for key in caught.value.keys]) == (1, ["x1"])


@pytest.mark.parametrize("kind", [Covariance, Information, SqrtInformation])
def test_matrices_must_be_square(kind: type[Covariance | Information | SqrtInformation]) -> None:
    for bad in (0.1, [0.1, 0.2], np.ones((2, 3)), np.ones((4, 2, 3))):
        with pytest.raises(NoiseModelError, match=rf"{kind.__name__}: shape .* expected \(m, m\) or \(n, m, m\)"):
            kind(bad)
    with pytest.raises(NoiseModelError, match="expected at most 3 axes"):
        kind(np.ones((1, 1, 2, 2)))
    with pytest.raises(NoiseModelError, match="expected at most 1 axes"):
        Isotropic([[0.1]])


def test_sigmas_go_to_the_component_they_name() -> None:
    space = SE3.components
    W = Diagonal(yaw=0.5, pitch=0.25, roll=0.2, z=0.1, y=2.0, x=1.0).sqrt_information(1, space)
    np.testing.assert_allclose(W, [[1.0, 0.5, 10.0, 5.0, 4.0, 2.0]])
    same = Diagonal(rz=0.5, ry=0.25, rx=0.2, depth=0.1, y=2.0, x=1.0).sqrt_information(1, space)
    np.testing.assert_array_equal(same, W)
    for alias in ("yaw", "theta", "heading", "h", "rz"):
        W = Diagonal(**{alias: 0.5, "x": 0.1, "y": 0.2}).sqrt_information(1, PLANE)
        np.testing.assert_allclose(W, [[10.0, 5.0, 2.0]])


def test_named_sigmas_are_given_once() -> None:
    with pytest.raises(NoiseModelError, match="name one component twice"):
        Diagonal(x=0.1, y=0.1, theta=0.1, yaw=0.2)
    with pytest.raises(NoiseModelError, match="not both"):
        Diagonal([0.1], x=0.1)
    with pytest.raises(NoiseModelError, match="give the sigmas in order, or each by its component's name"):
        Diagonal()


def test_the_caller_may_change_arrays_afterwards() -> None:
    Sigma, sigmas = np.eye(2), np.ones(2)
    noise, other = Covariance(Sigma), Diagonal(sigmas)
    Sigma[:], sigmas[:] = 100.0, 100.0
    np.testing.assert_array_equal(noise.sqrt_information(1, ("x", "y")), [[1.0, 1.0]])
    np.testing.assert_array_equal(other.sqrt_information(1, ("x", "y")), [[1.0, 1.0]])
