"""Own factors with data of their own: what their class declares for each measurement is cut, and nothing in silence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from factors import Diagonal, Factor, Isotropic, Prior, check_jacobians
from factors.joined import joined
from factors.keys import Keys
from models import Manifold, R
from models.algebra import Array
from models.errors import GraphError
from nls import FactorGraph, Incremental, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import refused

x, b = kinds("x", "b")
N = 5


class Drift(Factor):
    """A position that drifts at an unknown rate: h = x + t v, with whatever holds the times t."""

    slots = R(1), R(1)

    def __init__(self, point: Keys, rate: Keys, z: object, noise: Any, times: Any) -> None:
        super().__init__([point, rate], z, noise)  # type: ignore[arg-type]
        self.times = times

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(1)

    def t(self) -> Array:
        return np.asarray(self.times, dtype=float)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Any]:
        t = self.t()[:, None]
        return X[0] + t * X[1], (None, np.broadcast_to(t, (len(X[0]), 1))[..., None])


class Declared(Drift):
    per_measurement = ("times",)


VALUES = Values({x: (R(1), np.zeros((N, 1))), b: (R(1), [0.5])})
TIMES = np.arange(1.0, N + 1)


def drift(kind: type[Drift], times: Any, n: int = N) -> Drift:
    return kind(x[np.arange(n)], b[0], 0.3 * np.arange(n)[:, None], Isotropic(0.1), times)


ACTS: dict[str, Callable[[Factor], object]] = {
    "slice": lambda f: f[:3],
    "permutation": lambda f: f[::-1],
    "iteration": list,
    "check": lambda f: check_jacobians(f, VALUES),
    "incremental": lambda f: Incremental().update([Prior(x[:N], np.zeros((N, 1)), Isotropic(1.0)), f], VALUES),
    "joined": lambda f: joined([f.bind(R(1), R(1))] * 2),
}


@for_all(act=sorted(ACTS))
def test_an_undeclared_array_is_refused_at_the_first_cut(act: str) -> None:
    wrong = drift(Drift, TIMES)
    assert FactorGraph([wrong]).chi2(VALUES) > 0  # whole, it is what it is
    named = r'^Drift\(x.*: its attribute times is a ndarray of 5 for 5 .*per_measurement = \("times",\).*shared = '
    refused(lambda: ACTS[act](wrong), GraphError, named)
    ACTS[act](drift(Declared, TIMES))


@dataclass
class Clock:
    """Times within an object."""

    seconds: Any
    name: str = "clock"


@for_all(
    held=[
        (TIMES.tolist(), "times is a list"),
        (tuple(TIMES), "times is a tuple"),
        (np.array([f"{t}" for t in TIMES], dtype=object), "times is a ndarray"),
        (np.ones((N, 3, 2)), "times is a ndarray"),
        ({"t": TIMES, "u": 3.0}, r"times\['t'\] is a ndarray"),
        ({k: float(t) for k, t in enumerate(TIMES)}, "times is a dict"),
        ([TIMES, 1.0], r"times\[0\] is a ndarray"),
        ((TIMES, TIMES), r"times\[0\] is a ndarray"),
        ([[1.0], {"deep": TIMES.tolist()}], r"times\[1\]\['deep'\] is a list"),
        (Clock(TIMES), r"times\.seconds is a ndarray"),
        (sp.eye_array(N, format="csr"), "times is a csr_array"),
        (x[np.arange(N)], "times is a Keys"),
        (Diagonal(np.ones((N, 2))), r"times\.sigmas is a ndarray"),
    ]
)
def test_whatever_holds_a_row_for_each_measurement(held: tuple[Any, str]) -> None:
    refused(lambda: drift(Drift, held[0])[:2], GraphError, held[1])


@for_all(held=[None, 3.0, "hours", TIMES[:4], np.ones((1, N)), np.float64(2.0), np.array(2.0), {"t": TIMES[:2]}, [1.0]])
def test_what_has_no_row_for_each_measurement_passes(held: Any) -> None:
    assert drift(Drift, held)[:2].times is held


def test_a_coincidence_of_lengths_is_declared_as_shared() -> None:
    class Calibrated(Declared):
        shared = ("table",)

    class Undeclared(Declared):
        pass

    for kind in (Calibrated, Undeclared):
        three, five = (drift(kind, TIMES[:n], n) for n in (3, N))
        three.table = five.table = np.array([1.0, 2.0, 3.0])  # type: ignore[attr-defined]
        assert len(five[:2]) == 2
        if kind is Undeclared:
            refused(lambda three=three: three[:2], GraphError, "its attribute table is a ndarray of 3")
        else:
            assert three[:2].table.tolist() == [1.0, 2.0, 3.0]  # type: ignore[attr-defined]
    assert Calibrated.per_measurement == ("times",)  # that of its base class, too


def test_declarations_that_cannot_be_followed_are_refused() -> None:
    class Misspelt(Drift):
        per_measurement = ("tiems",)

    class Computed(Drift):
        per_measurement = ("seconds",)

        @property
        def seconds(self) -> Array:
            return self.t()

    for kind, named in ((Misspelt, "names 'tiems', which"), (Computed, "names 'seconds', which .* times")):
        refused(lambda kind=kind: drift(kind, TIMES)[:2], GraphError, named)
    refused(lambda: drift(Declared, TIMES.tolist())[:2], GraphError, "times is a list of 5 .* np.asarray")
    with pytest.raises(GraphError, match=r'per_measurement = "times" is no tuple of names; .*\("times",\)'):
        type("Word", (Drift,), {"per_measurement": "times"})


def test_the_check_finds_what_the_attributes_do_not_show() -> None:
    """Data in a closure: no attribute, and no part of the batch is right."""

    def hidden(times: Array) -> type[Drift]:
        class Hidden(Drift):
            def t(self) -> Array:
                return times

        return Hidden

    named = r"^Hidden\(x4, b0\): its residual is .* in a batch reversed of the measurements, .* per_measurement$"
    refused(lambda: check_jacobians(drift(hidden(TIMES), None), VALUES), GraphError, named)
    named = r"^Hidden\(x.*: a batch of the first 3 of its measurements raised ValueError: .*broadcast"
    refused(lambda: check_jacobians(drift(hidden(np.full(N, 2.0)), None), VALUES), GraphError, named)
