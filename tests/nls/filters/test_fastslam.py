"""FastSLAM: the same bits for a seed, the posterior a batch solution has, the errors known for its two versions."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

import sim
from factors import BearingRange, Between, Cauchy, Diagonal, Factor, Heading, Isotropic, Prior, Range, Robust
from models import SE2, R
from models.errors import GraphError, LeadlineError, OptionError, UnderconstrainedError
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters.base import steps
from nls.filters.fastslam import FastSLAM
from nls.filters.particles import covariance, each_once, effective, mean, normalized_weights, systematic
from tests.combinations import for_all

Version = Literal[1, 2]
close = np.testing.assert_allclose
x, l = kinds("x", "l")
both = for_all(version=[1, 2])


def small(*more: Factor) -> tuple[FactorGraph, Values]:
    """Four poses across the +-pi of the heading and three landmarks, one of them charted."""
    at = np.arange(4)
    i, k = np.array([(0, 0), (0, 1), (1, 0), (1, 1), (1, 2), (2, 2), (3, 1), (3, 2), (3, 0)]).T
    rng = np.random.default_rng(8)
    X = np.array([[0, 0, 3.0], [-1, 0.2, 3.1], [-2, 0.3, -3.1], [-3, 0.3, -3.0]])
    L = np.array([[-6, 3], [-5, -4], [-9, 1.0]])
    p = np.einsum("nji,nj->ni", SE2.rotation(X[i]), L[k] - X[i, :2])
    z = np.stack([np.arctan2(p[:, 1], p[:, 0]), np.hypot(*p.T)], axis=1) + rng.normal(0, [0.004, 0.02], (len(i), 2))
    first, chart = Prior(x[0], X[0], Diagonal([0.04, 0.02, 0.006])), Prior(l[[2]], [[-9.02, 1.02]], Isotropic(0.06))
    walk = Between(x[at[:-1]], x[at[1:]], SE2.between(X[:-1], X[1:]) + 0.005, Diagonal([0.02, 0.02, 0.006]))
    seen, heading = BearingRange(x[i], l[k], z, Diagonal([0.004, 0.02])), Heading(x[[2]], [-3.11], Isotropic(0.006))
    return FactorGraph([first, walk, seen, heading, chart, *more]), Values({x: (SE2, X), l: (R(2), L)})


@both
def test_a_seed_gives_the_same_bits(version: Version) -> None:
    graph, values = small()
    one, same, other = (FastSLAM(50, version, rng=np.random.default_rng(s)).run(graph, values) for s in (3, 3, 4))
    assert one.X.tobytes() == same.X.tobytes()
    assert one.values[l].tobytes() == same.values[l].tobytes()
    assert one.X.tobytes() != other.X.tobytes()


AGAIN = BearingRange(x[[1, 1, 3]], l[[0, 0, 1]], [[-0.47, 5.75], [-0.48, 5.7], [1.0, 4.78]], Diagonal([0.01, 0.05]))


@for_all(version=[1, 2], more=[[], [AGAIN]])
def test_with_many_particles_it_is_the_posterior_of_the_batch(version: Version, more: list[Factor]) -> None:
    graph, values = small(*more)
    best = graph.optimize(values).values
    marginals = Marginals(graph, best)
    track = FastSLAM(20_000, version, rng=np.random.default_rng(0)).run(graph, values)
    noise = {1: 0.2, 2: 0.1}[version]  # 700 and more effective particles at the end: 5 % and less of a variance
    P = marginals.covariance(x[3], frame="body")
    e = SE2.local(track.X[3][None], best[x[3]][None])[0]
    assert np.abs(e / np.sqrt(np.diag(P))).max() < noise
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    close(track.P[3] / scale, P / scale, atol=noise)
    P_l = marginals.covariance(track.landmarks)
    sigma = np.sqrt(np.diagonal(P_l, axis1=1, axis2=2))
    assert np.abs((track.values[track.landmarks] - best[track.landmarks]) / sigma).max() < noise
    close(np.diagonal(track.P_landmarks, axis1=1, axis2=2) / sigma**2, 1, atol=noise)


@both
def test_a_chart_that_comes_late_weighs_the_particles(version: Version) -> None:
    """Each particle has its own idea of where a landmark is that has been seen before."""
    graph, values = small()
    chart = Prior(l[[0]], [[-5.9, 3.06]], Isotropic(0.03))
    both_known = FactorGraph([*graph.factors, chart])
    without, best = (g.optimize(values).values[x[3]] for g in (graph, both_known))
    P = Marginals(both_known, both_known.optimize(values).values).covariance(x[3], frame="body")
    filter = FastSLAM(20_000, version, rng=np.random.default_rng(0))
    first, *middle, last = steps(graph, values)
    filter.start(first, values)
    for step in [*middle, replace(last, observations=[*last.observations, chart])]:
        filter.step(step)
    sigma = np.sqrt(np.diag(P))
    off, shift = (np.abs(SE2.local(X[None], best[None])[0] / sigma).max() for X in (filter.pose[0], without))
    assert off < {1: 0.25, 2: 0.12}[version] < 0.5 < shift


def test_a_batch_is_cut_so_that_no_landmark_comes_twice() -> None:
    graph, _ = small(AGAIN)
    parts = each_once(graph.factors[-1])
    assert [part.keys[1] for part in parts] == [l[[0, 1]], l[[0]]]
    assert each_once(parts[0]) == [parts[0]]


def test_headings_are_averaged_on_the_circle() -> None:
    X = np.array([[[0.0, 0.0, 3.1]], [[1.0, 0.0, -3.1]], [[2.0, 3.0, 3.0]]])
    w = np.array([0.25, 0.25, 0.5])
    center = mean(SE2, X, w)
    turn = (0.25 * (3.1 - np.pi) + 0.25 * (np.pi - 3.1) + 0.5 * (3.0 - np.pi)) + np.pi
    assert center[0, 2] == pytest.approx(turn)
    close(np.einsum("n,nd->d", w, SE2.local(np.broadcast_to(center[0], (3, 3)), X[:, 0])), 0, atol=1e-12)
    assert covariance(SE2, center, X, w)[0, 2, 2] < 0.02


def test_systematic_resampling_keeps_every_weight_up_to_one_particle() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        w = normalized_weights(rng.normal(0, 3, 40))
        count = np.bincount(systematic(w, rng), minlength=40)
        assert (np.abs(count - 40 * w) < 1).all()
        assert 1 <= effective(w) <= 40
    many = np.mean([np.bincount(systematic(w, rng), minlength=40) for _ in range(4000)], axis=0)
    close(many / 40, w, atol=4 * 0.5 / np.sqrt(4000) / 40)
    assert effective(np.full(40, 1 / 40)) == pytest.approx(40)


@both
def test_parents_give_every_particle_its_path_and_its_map(version: Version) -> None:
    """Where a step resamples, poses and landmarks are those of the parents; elsewhere nobody changes places."""
    world = sim.subsea(np.random.default_rng(0), laps=1, known_start=True)
    filter, resampled = FastSLAM(30, version, rng=np.random.default_rng(1)), 0
    first, *others = steps(world.graph, world.start)
    filter.start(first, world.start)
    assert filter.parents.tolist() == list(range(30))
    for step in others:
        X, few, m = filter.X.copy(), effective(filter.weights) < 15, filter.map
        assert m is not None
        numbers, L = m.numbers, m.L.copy()
        filter.step(step)
        (motion,) = step.motion
        expected = SE2.compose(X[filter.parents], np.repeat(motion.z, 30, axis=0))
        assert np.abs(SE2.local(expected, filter.X)[:, :2]).max() < 6 * 0.01 * 2.1
        unseen = ~np.isin(numbers, np.concatenate([f.keys[-1].numbers for f in step.observations]))
        close(m.L[:, : len(numbers)][:, unseen], L[filter.parents][:, unseen], atol=0)
        assert (filter.parents.tolist() == list(range(30))) is not few
        resampled += few
    assert resampled > 10


def test_lines_and_wheels() -> None:
    world = sim.lines(np.random.default_rng(0), laps=1)
    track = FastSLAM(30, rng=np.random.default_rng(0)).run(world.graph, world.start)
    assert len(track.landmarks) == 12
    assert track.ate(world.truth).rmse < 0.3 * world.ate(world.start)


def test_what_it_cannot_take_is_refused_by_name() -> None:
    walk = Between(x[[0, 1]], x[[1, 2]], [[1.0, 0, 0]] * 2, Isotropic(0.1))
    first = Prior(x[0], [0, 0, 0], Isotropic(0.1))
    values = Values({x: (SE2, SE2.identity(3)), l: (R(2), [[3.0, 4.0]])})
    far, loop = Range(x[1], l[0], [5.0], Isotropic(0.1)), Between(x[0], x[2], [2.0, 0, 0], Isotropic(0.1))
    robust, heading = Heading(x[1], [0.1], Robust(Isotropic(0.1), Cauchy(1.0))), Heading(x[0], [0.1], Isotropic(0.1))
    cases: list[tuple[list[Factor], type[LeadlineError], str]] = [
        ([first, walk, far], GraphError, r"Range\(x1, l0\) is the first to observe l0.*Prior"),
        ([first, walk, loop], GraphError, r"Between\(x0, x2\) is about more than x2.*or a Smoother"),
        ([first, walk, robust], GraphError, r"Heading\(x1\) has a robust kernel"),
        ([walk], GraphError, r"x0: no measurement of its own"),
        ([heading, walk], UnderconstrainedError, r"x0.*Heading.*Prior of x0"),
    ]
    for factors, error, match in cases:
        with pytest.raises(error, match=match):
            FastSLAM(10, rng=np.random.default_rng(0)).run(FactorGraph(factors), values)


def test_options_are_refused_by_name() -> None:
    rng = np.random.default_rng(0)
    for name, wrong in (("particles", 1), ("particles", True), ("version", 3), ("rng", 7)):
        with pytest.raises(OptionError, match=name):
            FastSLAM(**{"particles": 10, "rng": rng, name: wrong})


def test_a_range_alone_is_enough_for_a_landmark_that_is_charted() -> None:
    chart, heard = Prior(l[0], [3.0, 4.0], Isotropic(0.01)), Range(x[0], l[0], [4.5], Isotropic(0.01))
    graph = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(0.5)), chart, heard])
    values = Values({x: (SE2, SE2.identity(1)), l: (R(2), [[0.0, 0.0]])})
    track = FastSLAM(3000, rng=np.random.default_rng(0)).run(graph, values)
    assert np.hypot(*(track.X[0, :2] - [3, 4])) == pytest.approx(4.5, abs=0.03)
    close(track.values[l[0]], [3, 4], atol=0.01)
