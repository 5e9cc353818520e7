"""EpipolarArc: its cost against a general minimizer, its gradient, ends and mirrors, and the graph with the points."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
from scipy.optimize import least_squares

from factors import Diagonal, EpipolarArc, Factor, Huber, Information, Isotropic, Noise, Robust, SqrtInformation
from factors.keys import Keys
from models import SE3, euler
from models.algebra import Array
from models.errors import SingularGeometryError
from models.sensors import cartesian, range_azimuth
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused, same
from tests.factors.samples import Sample, around_each, derivative, situation, whiteners
from tests.factors.samples_sonar import ELIMINATING_SAMPLES

(x,) = kinds("x")
LIMIT = radians(7)
SIGMAS = np.array([0.01, radians(0.25), 0.01, radians(0.25)])
NOISE = Diagonal(SIGMAS)
MOUNT = euler.to_se3(np.array([0.1, -0.6, 0.2, 0.3, 0.05, 0.1]))
GENERAL = [0.2, 0.1, 0.5, 0.2, 0.05, 0.1]  # of the sonar: x, y, z, roll, pitch, yaw


def views(motion: list[float], h: Array, offset: Array | None = None, seed: int = 1) -> tuple[Array, Array]:
    """Two vehicle poses (2, 7), anywhere, whose sonar moves so in between, and what it sees of points h, exactly."""
    O = SE3.identity()[0] if offset is None else offset
    S_i = SE3.exp(np.random.default_rng(seed).normal(size=(1, 6)))
    S = np.concatenate([S_i, SE3.compose(S_i, SE3.exp(np.array([motion])))])
    z_j = range_azimuth(SE3.act(SE3.inverse(SE3.exp(np.array([motion]))), cartesian(h)[0]))[0]
    return SE3.compose(S, SE3.inverse(O)), np.column_stack([h[:, :2], z_j])


def points(m: int, seed: int = 0, el: float = LIMIT, around: float = 0.0) -> Array:
    """(r, az, el), in a fan about an azimuth."""
    return np.random.default_rng(seed).uniform([2, around - 0.25, -el], [6, around + 0.25, el], size=(m, 3))


def arcs(m: int, z: Array, noise: Noise = NOISE, limit: float = LIMIT, offset: Array | None = None) -> EpipolarArc:
    return EpipolarArc(x[[0] * m], x[[1] * m], z, noise, limit, offset)


def at(X: Array) -> Values:
    return Values({x: (SE3, X)})


def lowest(X: Array, z: Array, W: Array, limit: float, offset: Array | None) -> float:
    """chi2 of the best point of one pair of contacts, by a general minimizer from many elevations."""
    S = X if offset is None else SE3.compose(X, offset)

    def b(h: Array) -> Array:
        l = SE3.act(S[0], cartesian(h[None])[0][0])
        e = z - np.concatenate([h[:2], range_azimuth(SE3.act(SE3.inverse(S[1]), l)[None])[0][0]])
        e[1::2] = (e[1::2] + pi) % (2 * pi) - pi
        return np.asarray(W @ e)

    bounds = ([0.1, z[1] - 1, -limit], [20, z[1] + 1, limit])
    starts = np.array([-0.9, -0.3, 0.3, 0.9]) * limit
    return float(
        min(2 * least_squares(b, [*z[:2], el], bounds=bounds, xtol=1e-15, ftol=1e-15, gtol=1e-15).cost for el in starts)
    )


@for_all(motion=[GENERAL, [0, 0, 0.5, 0, 0, 0], [0.5, 0.3, 0, 0, 0, 0.2]], wrong=[3.0, 30.0])
def test_the_cost_is_that_of_the_best_point_in_the_aperture(motion: list[float], wrong: float) -> None:
    m, rng = 3, np.random.default_rng(2)
    offset = MOUNT if wrong > 3 else None
    X, z = views(motion, points(m), offset)
    z = z + wrong * SIGMAS * rng.normal(size=z.shape)
    W = whiteners(m, 4, 3) / SIGMAS
    factor = EpipolarArc(x[0], x[[1] * m], z, Information(W.mT @ W), LIMIT, offset)
    chi2 = [lowest(X, z[k], W[k], LIMIT, offset) for k in range(m)]
    same(factor.chi2(at(X)), chi2, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("offset", [None, np.tile(MOUNT, (9, 1))], ids=["at the vehicle", "each"])
@for_all(limit_and_azimuth=[(0.3, pi), (0.03, 0.0)])
def test_the_gradient_of_the_cost_is_exact_at_any_residual(
    offset: Array | None, limit_and_azimuth: tuple[float, float]
) -> None:
    """2 A'b = -d chi2, each measurement by itself, in both poses, with correlated noise; the lower limit is reached."""
    m, (limit, around), rng = 9, limit_and_azimuth, np.random.default_rng(4)
    X, z = views(GENERAL, points(m, around=around), None if offset is None else MOUNT)
    z = z + 5 * SIGMAS * rng.normal(size=z.shape)
    z[:, 1::2] = (z[:, 1::2] + pi) % (2 * pi) - pi
    W = whiteners(m, 4, 5) / SIGMAS

    def build(keys: tuple[Keys, ...], z: Array, noise: Noise) -> Factor:
        O = offset if offset is None else np.tile(offset, (len(z) // m, 1))
        return EpipolarArc(*keys, z, noise, limit, O)

    sample = Sample("arcs", (SE3, SE3), SE3, 4, build, np.zeros)
    pair = tuple(np.repeat(X[[k]], m, axis=0) for k in (0, 1))
    A, b = linearized(sample.factor(z, Information(W.mT @ W)), sample.values(pair))
    assert 5 < np.square(b).sum(axis=1).max() < 1e4  # azimuths wrap: a turn is 1,440 sigmas
    for slot in range(2):
        gradient = 2 * np.einsum("nij,ni->nj", A[slot], b)
        plus, minus = np.square(around_each(sample, pair, z, W, slot, 1e-6)).sum(axis=3)
        same(gradient, (minus - plus).T / 2e-6, rtol=1e-5, atol=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("sample", ELIMINATING_SAMPLES, ids=str)
def test_conformity_where_there_is_no_residual(sample: Sample) -> None:
    """No innovation, and A is minus the derivative of b."""
    n = 4
    situations = [situation(sample, case, n // 2, 1)[0] for case in ("truth", "state near pi")]
    X = tuple(np.concatenate(stacks) for stacks in zip(*situations, strict=True))
    z, W = sample.truth(*X), whiteners(n, 4, 1) / SIGMAS
    factor = sample.factor(z, SqrtInformation(W))
    A, b = linearized(factor, sample.values(X))
    same(b, 0.0, atol=1e-8)
    same(error(factor, sample.values(X)), b, atol=0)
    for slot, A_k in enumerate(A):
        same(A_k, -derivative(sample, X, z, W, slot), rtol=1e-6, atol=1e-6)


def test_motion_in_the_plane_has_two_mirror_images_of_one_cost() -> None:
    """Points above and below the plane are one; that below is taken, and with some heave whichever fits better."""
    h = points(6, el=0.1) + np.array([0, 0, 0.15])
    motion = [1.0, -0.6, 0, 0, 0, 0.3]
    (X, z), (_, above) = (views(motion, h * [1, 1, side]) for side in (1, -1))
    same(z, above, atol=1e-12)
    z = z + SIGMAS * np.random.default_rng(9).normal(size=z.shape)
    factor = arcs(6, z, limit=0.4)
    (_, A), b = linearized(factor, at(X))
    slope = -2 * np.einsum("ni,ni->n", A[:, :, 2], b)
    heaves = [SE3.retract(X[1:], np.array([[0, 0, s * 1e-5, 0, 0, 0]])) for s in (1, -1)]
    dived, climbed = (factor.chi2(at(np.concatenate([X[:1], Y]))) for Y in heaves)
    same(dived, climbed, rtol=1e-7)
    same((dived - np.square(b).sum(axis=1)) / 1e-5, -np.abs(slope), rtol=1e-2, atol=1e-3 * np.abs(slope).max())
    assert np.abs(slope).min() > 0
    for side in (1, -1):  # with a heave the side is known
        X, z = views([1.0, -0.6, 0.3, 0, 0, 0.3], h * [1, 1, side])
        same(error(arcs(6, z, limit=0.4), at(X)), 0.0, atol=1e-9)


def test_each_pair_keeps_its_offset_and_none_is_a_batch() -> None:
    X, z = views(GENERAL, points(5), MOUNT)
    offset = SE3.retract(np.tile(MOUNT, (5, 1)), 0.1 * np.random.default_rng(1).normal(size=(5, 6)))
    factor = arcs(5, z, Diagonal(np.tile(SIGMAS, (5, 1))), offset=offset)
    same(factor[[1, 3]].chi2(at(X)), factor.chi2(at(X))[[1, 3]], rtol=1e-9)
    assert len(EpipolarArc(x[[]], x[[]], np.zeros((0, 4)), NOISE, LIMIT).chi2(at(X))) == 0


def test_noise_that_leaves_the_target_open_is_refused_and_a_robust_one_is_none() -> None:
    X, z = SE3.identity(2), [[4.0, 0.1, 3.9, 0.0]]
    blind = arcs(1, z, Information(np.diag([0.0, 1.0, 0.0, 1.0])))
    refused(lambda: linearized(blind, at(X)), SingularGeometryError, "noise")
    assert error(arcs(1, z, Robust(Isotropic(), Huber(1))), at(X)).shape == (1, 4)
