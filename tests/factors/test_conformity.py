"""Conformity of every factor: a Factor subclass found in `factors` needs a sample, and every sample is tested."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

import numpy as np
import numpy.typing as npt
import pytest

import factors
from factors import Between, Factor, Information, Isotropic, Prior, SqrtInformation, check_jacobians
from factors.base import Model
from factors.conventions import CONVENTIONS
from factors.keys import Keys
from models import SE2, SE3, SO2, SO3, LieGroup, R
from models.algebra import wrap
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.samples import (
    CASES,
    GROUPS,
    Sample,
    full_noise,
    innovation_by_hand,
    situation,
    states,
    turned,
    whiteners,
)
from tests.factors.samples import SAMPLES as POSE_SAMPLES
from tests.factors.samples_camera import CAMERA_SAMPLES
from tests.factors.samples_plane import PLANE_SAMPLES
from tests.factors.samples_sensors import SENSOR_SAMPLES
from tests.factors.samples_sonar import ELIMINATING_SAMPLES, SONAR_SAMPLES

Array = npt.NDArray[np.float64]
SAMPLES = [*POSE_SAMPLES, *SENSOR_SAMPLES, *SONAR_SAMPLES, *CAMERA_SAMPLES, *PLANE_SAMPLES]
every_sample = pytest.mark.parametrize("sample", SAMPLES, ids=str)
every_convention = pytest.mark.parametrize("convention", CONVENTIONS)
STEP = 1e-5


def concrete_factors() -> set[type[Factor]]:
    """Every Factor subclass that can be made, public or not, in any module of `factors`."""
    modules = [importlib.import_module(m.name) for m in pkgutil.walk_packages(factors.__path__, "factors.")]
    found = {c for module in modules for c in vars(module).values() if inspect.isclass(c) and issubclass(c, Factor)}
    return {c for c in found if not inspect.isabstract(c)}


def without_sample(classes: set[type[Factor]]) -> set[str]:
    sampled = {type(s.factor(situation(s, "truth", 1, 0)[1], Isotropic())) for s in [*SAMPLES, *ELIMINATING_SAMPLES]}
    return {c.__name__ for c in classes - sampled}


def test_every_factor_has_a_sample() -> None:
    classes = concrete_factors()
    assert {Between, Prior} < classes
    assert without_sample(classes) == set(), "write samples of these factors in samples.py"

    class Unlisted(Prior):
        """A factor nobody wrote a sample for."""

    assert without_sample(classes | {Unlisted}) == {"Unlisted"}


def bound(sample: Sample, case: str, n: int, seed: int = 1) -> tuple[Factor, Values, Model, tuple[Array, ...]]:
    X, z = situation(sample, case, n, seed)
    factor = sample.factor(z, full_noise(n, sample.dim, seed))
    values = sample.values(X)
    return factor, values, *values.gather(factor)


def test_samples_are_what_their_case_says() -> None:
    for sample in SAMPLES:
        for case, low, high in (("truth", 0.0, 1e-9), ("near identity", 1e-9, 1e-5), ("large innovation", 0.1, 99.0)):
            size = np.linalg.norm(bound(sample, case, 7)[2].error(*situation(sample, case, 7, 1)[0]), axis=1)
            assert low <= size.max() <= high, (str(sample), case)


@every_sample
@for_all(case=CASES, n=[1, 7])
def test_b_alone_is_b_and_A_is_minus_its_derivative(sample: Sample, case: str, n: int) -> None:
    factor, values, model, X = bound(sample, case, n)
    A, b = model.linearize(*X)
    assert b.shape == (n, sample.dim)
    np.testing.assert_array_equal(model.error(*X), b)
    assert len(A) == len(sample.manifolds)
    z, W = situation(sample, case, n, 1)[1], whiteners(n, sample.dim, 1)
    for slot, (A_k, manifold) in enumerate(zip(A, sample.manifolds, strict=True)):
        assert A_k.shape == (n, sample.dim, manifold.dim)
        steps = np.repeat(STEP * np.concatenate([np.eye(manifold.dim), -np.eye(manifold.dim)]), n, axis=0)
        copies = len(steps) // n  # of the whole batch: each moved by one step
        moved = [np.tile(x, (copies, 1)) for x in X]
        moved[slot] = manifold.retract(moved[slot], steps)
        many = sample.factor(np.tile(z, (copies, 1)), SqrtInformation(np.tile(W, (copies, 1, 1))))
        many_model, stacks = sample.values(tuple(moved)).gather(many)
        plus, minus = many_model.error(*stacks).reshape(2, manifold.dim, n, sample.dim)
        derivative = np.moveaxis((plus - minus) / (2 * STEP), 0, -1)
        np.testing.assert_allclose(A_k, -derivative, rtol=1e-6, atol=2e-8)
    if n > 1 and case == "large innovation":
        assert check_jacobians(factor, values) < 1e-6


@every_sample
@for_all(case=["large innovation", "near identity", "residual near pi"])
def test_a_batch_is_its_measurements_one_by_one(sample: Sample, case: str) -> None:
    n, seed = 7, 3
    _, _, model, X = bound(sample, case, n, seed)
    z, W = situation(sample, case, n, seed)[1], whiteners(n, sample.dim, seed)
    A, b = model.linearize(*X)
    for k in range(n):
        one = sample.factor(z[[k]], SqrtInformation(W[k]))
        one_model, one_X = sample.values(tuple(x[[k]] for x in X)).gather(one)
        A_one, b_one = one_model.linearize(*one_X)
        np.testing.assert_allclose(b[[k]], b_one, rtol=1e-13, atol=1e-14)
        for A_k, A_k_one in zip(A, A_one, strict=True):
            np.testing.assert_allclose(
                A_k[[k]], A_k_one, rtol=1e-8, atol=1e-8 if "differences" in str(sample) else 1e-13
            )


@every_sample
@for_all(n=[1, 7])
def test_noise_free_measurements_leave_no_innovation(sample: Sample, n: int) -> None:
    for case in ("truth", "near identity", "state near pi"):
        X = situation(sample, case, n, 4)[0]
        z = np.asarray(sample.truth(*X), dtype=float)
        model, stacks = sample.values(X).gather(sample.factor(z, full_noise(n, sample.dim, 4)))
        np.testing.assert_allclose(model.error(*stacks), 0.0, atol=1e-12)


@every_sample
@for_all(case=["large innovation", "residual near pi", "state near pi"])
def test_b_and_chi2_by_hand(sample: Sample, case: str) -> None:
    n = 3
    _, _, model, X = bound(sample, case, n)
    z, W = situation(sample, case, n, 1)[1], whiteners(n, sample.dim, 1)
    h = np.asarray(sample.truth(*X), dtype=float)
    b = model.error(*X)
    for k in range(n):
        e = innovation_by_hand(sample.space, h[k], z[k], sample.convention)[model.rows]
        np.testing.assert_allclose(b[k], W[k] @ e, atol=1e-9)
        assert b[k] @ b[k] == pytest.approx(e @ W[k].T @ W[k] @ e, rel=1e-9)


@every_convention
def test_chi2_of_a_plane_edge_by_formula(convention: str) -> None:
    """(x, y, wrap theta) of z^-1 h for g2o, of h^-1 z for graphslam; V^-1 of that for log and gtsam."""
    rng = np.random.default_rng(5)
    xi, yi, ti, xj, yj, tj, xz, yz, tz = rng.uniform(-3, 3, size=9)
    Omega = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]])
    c, s = np.cos(ti), np.sin(ti)
    h = np.array([c * (xj - xi) + s * (yj - yi), -s * (xj - xi) + c * (yj - yi), tj - ti])
    z = np.array([xz, yz, tz])
    a, b = (z, h) if convention == "g2o" else (h, z)
    c, s, dx, dy = np.cos(a[2]), np.sin(a[2]), b[0] - a[0], b[1] - a[1]
    theta = (b[2] - a[2] + np.pi) % (2 * np.pi) - np.pi
    e = np.array([c * dx + s * dy, -s * dx + c * dy, theta])
    if convention in ("log", "gtsam"):
        p, q = np.sin(theta) / theta, (1 - np.cos(theta)) / theta
        e[:2] = np.linalg.solve([[p, -q], [q, p]], e[:2])
    assert chi2(SE2, [xi, yi, ti], [xj, yj, tj], z, Omega, convention) == pytest.approx(e @ Omega @ e, rel=1e-12)


@pytest.mark.parametrize("flipped", [False, True])
@every_convention
def test_chi2_of_a_turn_by_formula(convention: str, flipped: bool) -> None:
    """A rotation error of alpha about one axis: alpha^2 for log, else sin^2(alpha/2), whatever sign q has."""
    for alpha in (0.3, -0.3, 2.5, -3.0):
        z = np.array([0.0, 0.0, np.sin(alpha / 2), np.cos(alpha / 2)]) * (-1.0 if flipped else 1.0)
        e = alpha if convention in ("log", "gtsam") else np.sin(alpha / 2)
        found = chi2(SO3, [0, 0, 0, 1.0], [0, 0, 0, 1.0], z, 9 * np.eye(3), convention)
        assert found == pytest.approx(9 * e**2, rel=1e-12)


def test_angular_innovations_are_wrapped() -> None:
    for group, i, j, z in (
        (SO2, [3.0], [-3.0], [0.2]),
        (SE2, [0, 0, 3.0], [0, 0, -3.0], [0, 0, 0.2]),
        (SO2, [3.0], [-3.0], [0.2 + 2 * np.pi]),
        (SE2, [0, 0, 3.0], [0, 0, -3.0], [0, 0, 0.2 - 4 * np.pi]),
    ):
        e = 0.2 - (2 * np.pi - 6.0)
        for convention in CONVENTIONS:
            assert chi2(group, i, j, z, np.eye(group.dim), convention) == pytest.approx(float(wrap(e)) ** 2, abs=1e-12)


def chi2(group: LieGroup, X_i: object, X_j: object, z: object, Omega: Array, convention: str) -> float:
    (x,) = kinds("x")
    factor = Between(x[0], x[1], np.asarray(z, dtype=float), Information(Omega), convention)
    model, X = Values({x: (group, np.array([X_i, X_j]))}).gather(factor)
    return float(np.sum(model.error(*X) ** 2))


@pytest.mark.parametrize("group", [SE2, SO3, SE3], ids=str)
def test_log_equals_g2o_to_first_order_with_converted_information(group: LieGroup) -> None:
    """Rotation block / 4 and mixed blocks / 2 in space; verbatim in the plane."""
    n, rng = 7, np.random.default_rng(6)
    half = np.where(np.isin(group.components, ("roll", "pitch", "yaw")) & (group.point_dim == 3), 0.5, 1.0)
    W = whiteners(n, group.dim, 6)
    Omega = W.mT @ W
    X = tuple(states(group, n, "truth", rng) for _ in range(2))
    direction = turned(group, n, 1.0, 1.0, rng)
    off = []
    for size in (1e-2, 1e-3, 1e-4):
        z = group.retract(group.between(*X), size * direction)
        found = {}
        for convention, information in (("g2o", Omega), ("log", half[:, None] * Omega * half)):
            factor = Between(Keys("i", np.arange(n)), Keys("j", np.arange(n)), z, Information(information), convention)
            model, stacks = Values({"i": (group, X[0]), "j": (group, X[1])}).gather(factor)
            A, b = model.linearize(*stacks)
            found[convention] = np.sum(b**2, axis=1), A[1].mT @ A[1], (A[1].mT @ b[..., None])[..., 0]
        off.append([np.abs(p - q).max() / np.abs(p).max() for p, q in zip(found["g2o"], found["log"], strict=True)])
    assert max(off[0]) < 0.1
    for coarse, fine in zip(np.array(off), np.array(off)[1:], strict=False):
        assert (fine < 0.2 * coarse + 1e-10).all(), "the difference vanishes with the residual"
    assert max(off[2]) < 1e-3


@pytest.mark.parametrize("group", GROUPS, ids=str)
@every_convention
def test_one_step_reaches_a_measurement_close_by(group: LieGroup, convention: str) -> None:
    """Whatever the convention, solving A dx = b moves the variable to the measurement."""
    rng = np.random.default_rng(7)
    X = states(group, 5, "truth", rng)
    z = group.retract(X, turned(group, 5, 1e-4, 1e-4, rng))
    factor = Prior(Keys("x", np.arange(5)), z, full_noise(5, group.dim, 7), convention=convention)
    model, stacks = Values({"x": (group, X)}).gather(factor)
    (A,), b = model.linearize(*stacks)
    dx = np.linalg.solve(A, b[..., None])[..., 0]
    assert np.abs(group.local(group.retract(X, dx), z)).max() < 1e-7


def test_log_and_gtsam_are_one_residual() -> None:
    for group in GROUPS:
        found = []
        for convention in ("log", "gtsam"):
            sample = next(s for s in SAMPLES if str(s) == f"Between-{group}-{convention}")
            _, _, model, X = bound(sample, "large innovation", 7)
            found.append(model.linearize(*X))
        np.testing.assert_array_equal(found[0][1], found[1][1])
        np.testing.assert_array_equal(found[0][0][0], found[1][0][0])


def test_one_variable_serves_all_measurements() -> None:
    (x,) = kinds("x")
    rng = np.random.default_rng(8)
    X = states(SE2, 4, "truth", rng)
    z = rng.normal(size=(3, 3))
    shared = Between(x[0], x[1:4], z, Isotropic(0.1))
    spelled = Between(x[[0, 0, 0]], x[1:4], z, Isotropic(0.1))
    values = Values({x: (SE2, X)})
    model, stacks = values.gather(shared)
    assert stacks[0].shape == (3, 3)
    other, other_stacks = values.gather(spelled)
    np.testing.assert_array_equal(model.error(*stacks), other.error(*other_stacks))


def test_a_factor_binds_again_when_its_spaces_change() -> None:
    (x,) = kinds("x")
    factor = Prior(x[0], [1.0, 2.0, 0.5], Isotropic(1.0))
    first, X = Values({x: (SE2, [0, 0, 0])}).gather(factor)
    assert Values({x: (SE2, [1, 0, 0])}).gather(factor)[0] is first, "the whitener is computed once"
    second, Y = Values({x: (R(3), [0, 0, 0])}).gather(factor)
    assert second.space is R(3)
    assert np.abs(first.error(*X) - second.error(*Y)).max() > 0.1


def test_prior_in_space_measures_the_named_components() -> None:
    (x,) = kinds("x")
    z = [1.0, 2.0, 3.0, 0.0, 0.0, np.sin(0.2), np.cos(0.2)]
    names = ("yaw", "depth", "x")  # in the order asked for
    model, X = Values({x: (SE3, SE3.identity(1))}).gather(Prior(x[0], z, Isotropic(0.5), names, "graphslam"))
    np.testing.assert_allclose(model.error(*X), [[2 * np.sin(0.2), 6.0, 2.0]])
