"""What a user saves or sends to another process comes back the same, and works together with what stayed."""

from __future__ import annotations

import copy
import inspect
import multiprocessing
import pickle
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

import factors
import factors.function as function_module
import models
import nls
import sim
from factors import Factor, Huber, Isotropic, Noise
from factors.keys import kinds
from factors.robust import Kernel
from models import LINE, S2, SE2, SE3, SO2, SO3, Manifold, Measured, R
from models.errors import GraphError
from nls import FactorGraph, LinearSolver, Optimizer, Values, analysis, filters
from nls.filters import Filter
from tests.combinations import for_all
from tests.factors.test_conformity import PARTED, situation
from tests.sent import contents, received, things

(x,) = kinds("x")
# none leaves its call
INTERNAL = {"Automatic", "Bending", "Reusing", "FreeGauge", "NoOptimumError", "SpentError", "SparseSolver", "_Dense"}
SPLINES = {"SurveyLog"}  # those of SciPy take protocol 2 and above: tests/sim/test_survey.py
COPIES: dict[str, Callable[[Any], Any]] = {
    **{
        f"pickle {protocol}": lambda thing, protocol=protocol: pickle.loads(pickle.dumps(thing, protocol))
        for protocol in (0, 2, pickle.HIGHEST_PROTOCOL)  # the ways to reduce an object; processes take the default
    },
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}
every_copy = for_all(way=COPIES)


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return things(tmp_path_factory.mktemp("files"))


def parts(thing: Any, met: dict[int, Any]) -> Iterator[type]:
    """The classes of everything an object is made of."""
    if id(thing) not in met and not isinstance(thing, str | bytes | int | float | complex | slice | type | None):
        met[id(thing)] = thing
        yield type(thing)
        items = thing.items() if isinstance(thing, dict) else thing
        if not isinstance(thing, dict | list | tuple):
            items = () if isinstance(thing, np.ndarray) or callable(thing) else thing.__reduce_ex__(4)
        for item in items:
            yield from parts(item, met)


def subclasses(of: type) -> set[type]:
    """Those of the library that can be made."""
    below = {c for child in of.__subclasses__() for c in {child, *subclasses(child)}}
    return {
        c for c in below if not inspect.isabstract(c) and c.__module__.split(".")[0] in ("models", "factors", "nls")
    }


def test_every_class_has_an_object(objects: dict[str, Any]) -> None:
    made = set(parts(objects, {}))
    modules = (models, factors, nls, sim, filters, analysis)
    public = {getattr(module, name) for module in modules for name in module.__all__}
    bases = (Manifold, Noise, Kernel, Exception, LinearSolver, Optimizer, Filter)
    wanted = {c for c in public if isinstance(c, type)}.union(*map(subclasses, bases))
    missing = {c for c in wanted - made if not inspect.isabstract(c) and not issubclass(c, Factor | str)}
    assert {c.__name__ for c in missing} == INTERNAL | SPLINES


@every_copy
def test_a_space_is_one_object(way: str) -> None:
    spaces = [SO2, SE2, SO3, SE3, LINE, S2, R(1), R(3), R(7), Measured("range", "azimuth"), Measured("depth")]
    assert {type(space) for space in spaces} == subclasses(Manifold)
    for space in spaces:
        assert COPIES[way](space) is space
        assert COPIES[way]([space, space])[1] is space


@every_copy
def test_objects_come_back_the_same(objects: dict[str, Any], way: str) -> None:
    for name, thing in objects.items():
        items = thing if isinstance(thing, list) else [thing]
        for item in items:  # each alone
            assert contents(COPIES[way](item)) == contents(item), (name, item)


@every_copy
def test_factors_from_elsewhere_work_with_values_from_here(way: str) -> None:
    for sample in {(str(s).split("-")[0], str(s).split("-")[-1]): s for s in PARTED}.values():
        X, z = situation(sample, "large innovation", 3, 1)
        factor, values = sample.factor(z, Isotropic(0.5)), sample.values(X)
        A, b = FactorGraph([factor]).linearize(values)
        copied = COPIES[way](factor)
        both = FactorGraph([factor, copied]).linearize(values)
        assert np.array_equal(both.b, np.tile(b, 2)), sample
        assert np.array_equal(both.A.toarray(), np.tile(A.toarray(), (2, 1))), sample
        arrays = {name: a for name, a in vars(factor).items() if isinstance(a, np.ndarray)}
        assert not any(a.flags.writeable or getattr(copied, name).flags.writeable for name, a in arrays.items()), sample


@every_copy
def test_values_from_elsewhere_work_with_a_graph_from_here(way: str) -> None:
    world = sim.subsea(np.random.default_rng(0), laps=1, known_start=True)
    step = 1e-3 * np.random.default_rng(1).normal(size=world.start.dim)
    start = COPIES[way](world.start)
    for kind, stack in world.start.stacks.items():
        assert start.stacks[kind].manifold is stack.manifold
        assert start.stacks[kind].X.flags.f_contiguous  # the layout the hot paths want
    there, here = start.retract(step), world.start.retract(step)
    assert all(np.array_equal(there[kind], here[kind]) for kind in kinds("x", "l"))
    system, graph = world.graph.linearize(start), COPIES[way](world.graph)
    assert np.array_equal(system.b, world.graph.linearize(world.start).b)
    assert graph.chi2(start) == world.graph.chi2(world.start)
    copied = COPIES[way](system)
    assert np.array_equal(nls.gauss_newton_step(copied), nls.gauss_newton_step(system))
    assert copied.rows == system.rows


@every_copy
def test_covariances_from_elsewhere(objects: dict[str, Any], way: str) -> None:
    for name in (name for name in objects if name.startswith("marginals")):
        original = objects[name]
        copied = COPIES[way](original)
        assert np.array_equal(copied.covariance(x[[3, 5]], "world"), original.covariance(x[[3, 5]], "world")), name
        assert np.array_equal(copied.all(x, "body"), original.all(x, "body")), name


def local(X: np.ndarray) -> np.ndarray:
    return X


def test_a_function_no_other_process_can_find_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(function_module, "BY_VALUE", frozenset())  # another test may have imported cloudpickle
    values = Values({x: (R(2), [[1, 0.5]])})
    for residual, jacobians in ((lambda X: X, None), (partial(lambda a, X: a * X, 2), None), (local, lambda X: (X,))):
        factor = Factor.from_function(residual, x[0], 2, jacobians=jacobians)
        for thing in (factor, [factor], FactorGraph([factor]), factor.robust(Huber(1.0))):
            for protocol in (0, 2, pickle.HIGHEST_PROTOCOL):
                with pytest.raises(GraphError, match=r"\(x0\): its function cannot be pickled: .*lambda.*Define it"):
                    pickle.dumps(thing, protocol)
        for way in ("copy", "deepcopy"):
            assert COPIES[way](factor).chi2(values) == factor.chi2(values)


class Held:
    """A residual that holds the graph it is part of."""

    def residual(self, X: np.ndarray) -> np.ndarray:
        return X - len(self.graph)

    def __init__(self) -> None:
        self.graph = FactorGraph()
        self.graph.add(Factor.from_function(self.residual, x[0], 2))
        self.graph.add(Factor.from_function(self.residual, x[1], 2))


@every_copy
def test_a_function_may_hold_its_graph(way: str) -> None:
    copied = COPIES[way](Held().graph)
    assert copied.chi2(Values({x: (R(2), [[1, 0], [2, 2]])})) == 1 + 4


def test_everything_through_another_process(objects: dict[str, Any]) -> None:
    """Spawned, which imports everything anew: what a fork finds in place has to be sent as well."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=received, args=(there,), daemon=True)
    process.start()
    there.close()
    with here:
        here.send(objects)
        assert here.poll(60)
        read, returned = here.recv()
    process.join()
    assert process.exitcode == 0
    for name, thing in objects.items():
        assert read[name] == contents(thing), name
        assert contents(returned[name]) == contents(thing), name
    assert returned["values"].stacks["x"].manifold is SE2
