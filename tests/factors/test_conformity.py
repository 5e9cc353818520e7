"""Conformity of every factor: a Factor subclass found in `factors` needs a sample, and every sample is tested."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import factors
from factors import Between, Factor, Information, Isotropic, Noise, Prior, SqrtInformation, check_jacobians
from factors.joined import joined
from models import LINE, SE2, SE3, LieGroup, Manifold, R
from models.algebra import Array
from models.errors import GraphError, NoiseModelError
from models.sensors import line_from_frame
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors import samples
from tests.factors.evaluated import error, linearized, refused, same, same_rows
from tests.factors.samples import CASES, Sample, derivative, full_noise, innovation_by_hand, situation, whiteners
from tests.factors.samples_sensors import PLANE_SAMPLES, SENSOR_SAMPLES
from tests.factors.samples_sonar import ELIMINATING_SAMPLES, SONAR_SAMPLES

SAMPLES = [*samples.SAMPLES, *SENSOR_SAMPLES, *SONAR_SAMPLES, *PLANE_SAMPLES]
every_sample = pytest.mark.parametrize("sample", SAMPLES, ids=str)
PARTED = [sample for sample in [*SAMPLES, *ELIMINATING_SAMPLES] if not sample.name.startswith("from_function")]


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


TRAITS = {
    "damped": {"BundleProjection", "ElevationHinge", "EpipolarArc", "Projection"},
    "limit_only": {"ElevationHinge"},
    "locates": {"BearingRange", "Landmark", "Line"},
    "sequential": {"SequentialMatch"},
}


@pytest.mark.parametrize("trait", TRAITS)
def test_which_factors_have_a_trait(trait: str) -> None:
    assert {c.__name__ for c in concrete_factors() if getattr(c, trait, False)} == TRAITS[trait]


def batch(sample: Sample, each: int = 3) -> tuple[tuple[Array, ...], Array, Array]:
    """Stacks of variables, measurements and whiteners: some of every case, so that a batch mixes them."""
    situations = [situation(sample, case, each, seed) for seed, case in enumerate(CASES)]
    X = tuple(np.concatenate(stacks) for stacks in zip(*(X for X, _ in situations), strict=True))
    z = np.concatenate([z for _, z in situations])
    return X, z, whiteners(len(z), sample.dim, 1)


@every_sample
def test_A_is_minus_the_derivative_of_b_and_a_batch_its_measurements_one_by_one(sample: Sample) -> None:
    X, z, W = batch(sample)
    n, m = len(z), sample.dim
    model, stacks = sample.values(X).gather(sample.factor(z, SqrtInformation(W)))
    A, b = model.linearize(*stacks)
    assert b.shape == (n, m)
    np.testing.assert_array_equal(model.error(*stacks), b)
    for slot, (A_k, manifold) in enumerate(zip(A, sample.manifolds, strict=True)):
        assert A_k.shape == (n, m, manifold.dim)
        same(A_k, -derivative(sample, X, z, W, slot), rtol=1e-6, atol=2e-8)
    for k in range(0, n, n // len(CASES)):
        one = sample.factor(z[[k]], SqrtInformation(W[k]))
        A_one, b_one = linearized(one, sample.values(tuple(x[[k]] for x in X)))
        same(b[[k]], b_one, rtol=1e-13, atol=5e-14)
        for A_k, A_k_one in zip(A, A_one, strict=True):
            same(A_k[[k]], A_k_one, rtol=1e-8, atol=1e-8 if "differences" in str(sample) else 1e-13)


@every_sample
def test_rows_that_are_linearized_again_are_those_of_the_new_values(sample: Sample) -> None:
    X, z, W = batch(sample)
    model, stacks = sample.values(X).gather(sample.factor(z, SqrtInformation(W)))
    begun = np.concatenate(model.linearize(*stacks)[0], axis=2)
    A, steps = begun.copy(), np.random.default_rng(3).normal(scale=0.1, size=(len(z), 20))
    moved = [m.retract(x, steps[:, : m.dim]) for m, x in zip(sample.manifolds, stacks, strict=True)]
    framed = [m.framed(x) for m, x in zip(sample.manifolds, moved, strict=True)] if model.factor.framed else moved
    e = model.factor.relinearize(model, framed, A)
    assert (e is not None) == (
        type(model.factor) is Between and sample.convention == "g2o" and sample.space in (SE2, SE3)
    )
    if e is None:
        return np.testing.assert_array_equal(A, begun)
    A_there, b_there = model.linearize(*moved)
    same(A, np.concatenate(A_there, axis=2), rtol=1e-12, atol=1e-12)
    same(model.whitened(e), b_there, rtol=1e-13, atol=1e-13)
    assert abs(A - begun).max() > 0.01


@every_sample
def test_b_by_hand(sample: Sample) -> None:
    X, z, W = batch(sample)
    values, h = sample.values(X), np.asarray(sample.truth(*X), dtype=float)
    model, stacks = values.gather(sample.factor(z, SqrtInformation(W)))
    assert model.space is sample.space, "its components name sigmas and rows"
    e = np.array(
        [innovation_by_hand(sample.space, a, c, sample.convention)[model.rows] for a, c in zip(h, z, strict=True)]
    )
    same(model.error(*stacks), (W @ e[..., None])[..., 0], rtol=1e-9, atol=1e-9)
    same(error(sample.factor(h, SqrtInformation(W)), values), 0.0, atol=1e-12)
    sizes = np.linalg.norm(e, axis=1).reshape(len(CASES), -1).max(axis=1)
    for case, low, high in (("truth", 0.0, 1e-9), ("near identity", 1e-9, 1e-5), ("large innovation", 0.1, 99.0)):
        assert low <= sizes[CASES.index(case)] <= high, case


@for_all(sample=PARTED)
def test_what_does_not_fit_is_refused_by_name(sample: Sample) -> None:
    """Another number of values or measurements, a number that is none, another space of each variable."""
    X, z = situation(sample, "truth", 3, 0)
    keys, broken = sample.factor(z, Isotropic()).keys, z.copy()
    broken[1, -1] = np.nan
    for wrong, named in (
        (np.column_stack([z, np.abs(z[:, 0])]), "expected"),
        (z[[0, 1, 2, 0]], r"\[0, 1, 2\]"),
        (broken, "element 1 .*not finite"),
    ):
        refused(lambda wrong=wrong: sample.values(X).gather(sample.build(keys, wrong, Isotropic())), GraphError, named)
    for slot in range(len(X)):
        spaces, stacks = list(sample.manifolds), list(X)
        spaces[slot], stacks[slot] = R(9), np.zeros((3, 9))
        values = replace(sample, manifolds=tuple(spaces)).values(tuple(stacks))
        refused(lambda values=values: values.gather(sample.factor(z, Isotropic())), GraphError, r"R\(9\)")


@for_all(sample=PARTED)
def test_parts_have_the_rows_of_the_batch_and_are_joined_to_it(sample: Sample) -> None:
    n, case = 7, "truth" if sample in ELIMINATING_SAMPLES else "large innovation"
    X, z = situation(sample, case, n, 11)
    values, whole = sample.values(X), sample.factor(z, full_noise(n, sample.dim, 11))
    for _ in ("not bound yet", "bound"):
        part = whole[[5, 0, -1, 5]]
        for name in ("convention", "slots", "unmoved", "relative", "components"):
            assert getattr(part, name, None) == getattr(whole, name, None)
        np.testing.assert_array_equal(part.z, z[[5, 0, 6, 5]])
        assert not part.z.flags.writeable
        same_rows(part, whole, [5, 0, 6, 5], values)
    same_rows(part[[1]], whole, [0], values)  # a part of a part
    (again,) = joined([values.gather(whole[rows])[0] for rows in ([0], [1, 2, 3], [4, 5, 6])])
    same_rows(again, whole, list(range(n)), values)
    np.testing.assert_array_equal(whole.z, z)
    for n in (2, 3, 4, 6):  # as many as something else has rows
        assert len(sample.factor(z[:n], Isotropic())[::-1]) == n


def moved_together(group: LieGroup, space: Manifold, X: Array, turn: float) -> Array:
    """Poses, points or lines after one motion of everything: a shift, and a turn."""
    group = {R(2): SE2, R(3): SE3}.get(group, group)
    T = group.exp(np.where(np.array([c in ("x", "y", "z") for c in group.components]), 0.7, turn)[None])
    if space is LINE:
        return line_from_frame(np.tile(T, (len(X), 1)), X)
    return group.compose(T, X) if space is group or space.dim not in (2, 3) else group.act(T, X)


@for_all(sample=[sample for sample in PARTED if sample.name != "BundleProjection"])  # its camera is world to camera
def test_what_is_relative_stays_when_everything_moves(sample: Sample) -> None:
    """The spaces decide: the difference of two poses stays in a turn, that of two points does not."""
    X, z = situation(sample, "truth" if sample in ELIMINATING_SAMPLES else "large innovation", 3, 2)
    factor, group = sample.factor(z, Isotropic()), sample.manifolds[0]
    stays = {}
    for turn in (0.0, 0.7):
        stacks = enumerate(zip(sample.manifolds, X, strict=True))
        Y = tuple(x if k in factor.unmoved else moved_together(group, space, x, turn) for k, (space, x) in stacks)
        stays[turn] = np.abs(error(factor, sample.values(Y)) - error(factor, sample.values(X))).max() < 1e-9
    assert stays[0.7] == (factor.relative and not factor.knows_axes(sample.manifolds))
    assert stays[0.0] or not factor.relative


NOISES: list[Callable[[int, int], Noise]] = [  # for n measurements of m numbers; n = 1: for all
    lambda n, m: factors.Covariance(np.tile(np.eye(m), (n, 1, 1))),
    lambda n, m: factors.Diagonal(np.ones((n, m))),
    lambda n, m: Information(np.tile(np.eye(m), (n, 1, 1))),
    lambda n, m: SqrtInformation(np.tile(np.eye(m), (n, 1, 1))),
    lambda n, m: factors.Diagonal(**{f"c{k}": np.ones(n) for k in range(m)}),
    lambda n, m: factors.Robust(NOISES[0](n, m), factors.Huber(1.0)),
]


def test_a_noise_of_another_size_is_refused_when_a_factor_is_made() -> None:
    sized = {(type(sample.space), sample.dim, str(sample).split("-")[0]): sample for sample in SAMPLES}
    for (_, m, name), sample in sized.items():
        for n in (1, 4) if name != "ElevationHinge" else ():  # which takes none
            z = situation(sample, "truth", n, 0)[1]
            assert all(len(sample.factor(z, noise(count, m))) == n for noise in NOISES[:2] for count in (1, n))
            for noise in (*(noise(n + 1, m) for noise in NOISES), Isotropic(np.ones(n + 1))):
                with pytest.raises(NoiseModelError, match="measurements, there are"):
                    sample.factor(z, noise)
            for other in (m + 1 + (z.shape[1] > m), m + 3):  # a quaternion may be a vector of four numbers
                for sizes in NOISES:
                    with pytest.raises(NoiseModelError, match=rf"for {other} numbers, expected {m}"):
                        sample.factor(z, sizes(1, other))


@pytest.mark.filterwarnings("ignore:.* nothing to compare:nls.GraphWarning")
def test_check_jacobians_accepts_every_factor() -> None:
    for sample in {str(sample).split("-")[0]: sample for sample in SAMPLES}.values():
        X, z = situation(sample, "large innovation", 3, 1)
        assert check_jacobians(sample.factor(z, full_noise(3, sample.dim, 1)), sample.values(X)) < 1e-6, sample


def test_a_factor_binds_again_when_its_spaces_change() -> None:
    (x,) = kinds("x")
    factor = Prior(x[0], [1.0, 2.0, 0.5], Isotropic(1.0))
    first, X = Values({x: (SE2, [0, 0, 0])}).gather(factor)
    assert Values({x: (SE2, [1, 0, 0])}).gather(factor)[0] is first, "the whitener is computed once"
    second, Y = Values({x: (R(3), [0, 0, 0])}).gather(factor)
    assert second.space is R(3)
    assert np.abs(first.error(*X) - second.error(*Y)).max() > 0.1
