"""Wrong arguments: whatever is given to a constructor, method or option, only errors of the library come out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import factors as f
from factors import Between, Factor, Huber, Isotropic, Landmark, Prior
from models import SE2, SE3, Manifold, R
from models.errors import LeadlineError
from nls import FactorGraph, GaussNewton, GraphError, Keys, Kind, LevenbergMarquardt, Marginals, Stop, Values, kinds
from nls.linear import LU, QR, Cholesky, DenseCholesky, DenseQR, Pinv

x, l = kinds("x", "l")
NOISE = Isotropic(0.1)
POSE = [0.0, 0.0, 0.0]
START = Values({x: (SE2, [POSE, [1.0, 0.0, 0.0]]), l: (R(2), [[2.0, 3.0]])})


class Odd:
    """Something nobody has thought of."""

    def __repr__(self) -> str:
        return "Odd()"


ODD: tuple[Any, ...] = (
    *(None, "text", "", b"bytes", 1.5, True, -1, 0, 1j, float("nan"), float("inf"), 2**62, Odd(), Odd, len),
    *([], [[]], {}, {"a": 1}, (), set(), [1j], [None], [[1.0], [1.0, 2.0]], [float("nan")] * 3, [float("inf")] * 3),
    *(np.zeros(0), np.zeros((2, 3)), np.array(["a", "b"]), np.array([None, None])),
    *(np.datetime64("2020-01-01"), range(3)),
    *(x, x[0], l[0], x[[0, 1, 2]], x[7], SE3, Isotropic(1.0), Huber(1.0), lambda X: X),
)


def graph() -> FactorGraph:
    step, seen = Between(x[0], x[1], [1.0, 0.0, 0.0], NOISE), Landmark(x[0], l[0], [2.0, 3.0], NOISE)
    return FactorGraph([Prior(x[0], POSE, NOISE), step, seen])


def used(make: Callable[..., Factor]) -> Callable[..., object]:
    """The factor in a graph, for two steps: many mistakes show only there."""

    def use(**arguments: Any) -> object:
        steps = GaussNewton(Stop(max_iterations=2))
        return FactorGraph([*graph().factors, make(**arguments)]).optimize(START, steps)

    return use


def prior(noise: Callable[..., Any]) -> Callable[..., object]:
    return used(lambda **arguments: Prior(x[0], POSE, noise(**arguments)))


def method(name: str) -> Callable[..., object]:
    return lambda **arguments: getattr(graph(), name)(**arguments)


def entry(**arguments: Any) -> object:
    given = {"manifold": SE2, "X": [POSE], "numbers": [0], **arguments}
    return Values({x: (given["manifold"], given["X"], given["numbers"])})


def item(of: Any) -> Callable[..., object]:
    return lambda index: of[index]


def assigned(key: object, X: object) -> None:
    START.copy()[key] = X  # type: ignore[index, assignment]


SENSOR = {"pose": x[0], "noise": NOISE, "offset": None}
CALLS: dict[str, tuple[Callable[..., object], dict[str, Any]]] = {
    "Between": (used(Between), {"i": x[0], "j": x[1], "z": [1.0, 0.0, 0.0], "noise": NOISE, "convention": "log"}),
    "Prior": (used(Prior), {"key": x[0], "z": POSE, "noise": NOISE, "convention": "log", "offset": None}),
    "Landmark": (used(Landmark), {**SENSOR, "point": l[0], "z": [2.0, 3.0]}),
    "Range": (used(f.Range), {**SENSOR, "target": l[0], "z": [3.6]}),
    "Bearing": (used(f.Bearing), {**SENSOR, "target": l[0], "z": [1.0]}),
    "BearingRange": (used(f.BearingRange), {**SENSOR, "target": l[0], "z": [[1.0, 3.6]]}),
    "Position": (used(f.Position), {**SENSOR, "z": [0.0, 0.0]}),
    "Heading": (used(f.Heading), {"pose": x[0], "z": [0.0], "noise": NOISE}),
    "BetweenSensors": (
        used(f.BetweenSensors),
        {"i": x[0], "j": x[1], "z": [1.0, 0.0, 0.0], "noise": NOISE, "offset": (np.zeros(3), np.zeros(3))},
    ),
    "Factor.from_function": (
        used(lambda **arguments: Factor.from_function(keys=x[0], dim=3, **arguments)),
        {"residual": lambda X: X, "jacobians": None},
    ),
    "Isotropic": (prior(Isotropic), {"sigma": 1.0}),
    "Diagonal": (prior(f.Diagonal), {"sigmas": [1.0, 1.0, 1.0]}),
    "Diagonal by name": (prior(f.Diagonal), {"x": 1.0, "y": 1.0, "yaw": 1.0}),
    **{
        kind.__name__: (prior(kind), {"matrix": np.eye(3)}) for kind in (f.Covariance, f.Information, f.SqrtInformation)
    },
    "Robust": (prior(f.Robust), {"noise": NOISE, "kernel": Huber(1.0)}),
    **{kernel.__name__: (kernel, {"c": 1.0}) for kernel in (Huber, f.Cauchy, f.Tukey, f.GemanMcClure, f.Welsch, f.DCS)},
    "FactorGraph": (FactorGraph, {"factors": []}),
    "FactorGraph.add": (method("add"), {"factor": Prior(x[0], POSE, NOISE)}),
    "FactorGraph.remove": (method("remove"), {"factor": None}),
    "FactorGraph.fix": (method("fix"), {"keys": x[0]}),
    "FactorGraph.release": (method("release"), {"keys": x[0]}),
    "FactorGraph.robust": (method("robust"), {"kernel": Huber(1.0)}),
    "FactorGraph.chi2": (method("chi2"), {"values": START}),
    "FactorGraph.linearize": (method("linearize"), {"values": START}),
    "FactorGraph.optimize": (
        method("optimize"),
        {"values": START, "optimizer": None, "linear_solver": None, "gauge": "first"},
    ),
    "Values": (Values, {"stacks": None}),
    "Values entry": (entry, {"manifold": SE2, "X": [POSE], "numbers": [0]}),
    "Values[]": (item(START), {"index": x[0]}),
    "Values[] =": (assigned, {"key": x[0], "X": POSE}),
    "Values.retract": (START.retract, {"delta": np.zeros(8)}),
    "Values.stack": (START.stack, {"kind": "x"}),
    "in Values": (lambda key: key in START, {"key": x[0]}),
    "Keys": (Keys, {"kind": "x", "numbers": [0]}),
    "Keys[]": (item(x[[0, 1]]), {"index": 0}),
    "Kind": (Kind, {"name": "x"}),
    "Kind[]": (item(x), {"index": 0}),
    "Kind[:]": (lambda start, stop, step: x[start:stop:step], {"start": 0, "stop": 3, "step": 1}),
    "kinds": (lambda name: kinds(name), {"name": "x"}),
    "SE2.stack": (SE2.stack, {"X": [POSE]}),
    "Stop": (Stop, dict.fromkeys(("update_sigmas", "update_tol", "chi2_rtol", "max_iterations", "max_seconds"), 1)),
    **{solver.__name__: (solver, {"memory_limit": 1e9}) for solver in (Cholesky, LU, QR, DenseQR, DenseCholesky)},
    "Pinv": (Pinv, {"rtol": 1e-12, "memory_limit": 1e9}),
    "LevenbergMarquardt": (LevenbergMarquardt, {}),
    "Marginals": (
        lambda **arguments: Marginals(graph(), START, **arguments),
        {"linear_solver": None, "gauge": "first"},
    ),
    "Marginals.covariance": (
        lambda **arguments: Marginals(graph(), START).covariance(**arguments),
        {"keys": x[1], "frame": "body", "view": None},
    ),
    "Marginals.all": (
        lambda **arguments: Marginals(graph(), START).all(**arguments),
        {"kind": x, "frame": "body", "view": None},
    ),
}
TEXTS = {"convention", "gauge", "frame", "view"}  # arrays are no mistake anyone makes there


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", CALLS)
def test_only_errors_of_the_library_come_out(name: str) -> None:
    call, good = CALLS[name]
    if name != "FactorGraph.remove":
        call(**good)
    for parameter in good:
        refused = 0
        for odd in ODD:
            if parameter in TEXTS and isinstance(odd, np.ndarray):
                continue
            sentence = None
            try:
                call(**{**good, parameter: odd})
            except LeadlineError as error:
                sentence = str(error)
            except Exception as error:
                given = f"{name}({parameter}={odd!r:.40})"
                raise AssertionError(f"{given} raised {type(error).__name__}: {error}") from error
            if sentence is not None:
                refused += 1
                assert 15 < len(sentence) < 2000, f"{odd!r:.40}: too short or too long: {sentence}"
        assert refused > len(ODD) // 4, f"{parameter}: hardly anything was refused"


def test_what_refused_is_as_it_was() -> None:
    changed, values = graph(), START.copy()
    for odd in ODD:
        if not isinstance(odd, Keys):
            for name in ("add", "remove", "fix", "release"):
                with pytest.raises(GraphError):
                    getattr(changed, name)(odd)
        if not isinstance(odd, Manifold):
            with pytest.raises(GraphError, match="no space"):
                Values({x: (odd, [POSE])})
        for key in (x, x[0], x[[0, 1]]):
            try:
                values[key] = odd
            except GraphError:
                continue
            values[key] = START[key]
    assert (len(changed.factors), changed.fixed) == (3, [])
    for kind in (x, l):
        assert np.array_equal(values[kind], START[kind])


def test_a_kind_has_no_end() -> None:
    """Without a word a loop over a kind would never end: indexing works for every number."""
    with pytest.raises(GraphError, match=r"x is a kind of variables without an end; name those you mean, x\[0:10\]"):
        list(x)
