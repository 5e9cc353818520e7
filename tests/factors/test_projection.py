"""Projection: what is refused and by what name, whose offset it is, and how optimizers go around what is behind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from factors import Diagonal, Factor, Isotropic, Projection
from models import SE2, SE3, R
from models.errors import GraphError, NoiseModelError, OptionError, SingularGeometryError
from models.sensors import Camera
from nls import Dogleg, FactorGraph, GaussNewton, LevenbergMarquardt, Optimizer, Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused, same

Array = npt.NDArray[np.float64]
x, l, o = kinds("x", "l", "o")
UNIT = Isotropic()
CAMERA = Camera((600.0, 500.0), (640.0, 480.0), (-0.2, 0.05, 0.001, -0.002))
HERE = SE3.identity()[0]


def test_a_point_behind_is_named_and_not_mirrored() -> None:
    X = SE3.exp(np.array([[0, 0, 0, 0, 0, 0], [0, 0, 10, 0, 0, 0.0]]))
    values = Values({x: (SE3, X), l: (R(3), [[1.0, 0.5, 5.0], [-1.0, -0.5, 5.0]])})
    factor = Projection(x[[0, 1]], l[[0, 1]], [[0.2, 0.1], [0.2, 0.1]], UNIT)  # (-1, -0.5, -5): the mirrored image
    for evaluate in (error, linearized, lambda factor, values: FactorGraph([factor]).optimize(values)):
        named = r"Projection\(x1, l1\): .* behind"
        caught = refused(lambda evaluate=evaluate: evaluate(factor, values), SingularGeometryError, named)
        assert caught.factor == "Projection"
        assert caught.keys == (x[[1]], l[[1]])
    graph = FactorGraph([Projection(x[[1]], l[[1]], [[0.2, 0.1]], UNIT, offset=o[0])])
    mounted = Values({x: (SE3, X), l: (R(3), values[l]), o: (SE3, HERE)})
    refused(lambda: graph.chi2(mounted), SingularGeometryError, r"Projection\(x1, l1, o0\): .* behind")


def two_views(start: list[float]) -> tuple[FactorGraph, Values, Array]:
    """A point 4 m ahead of two known cameras, 0.3 m apart, that starts elsewhere."""
    X, L = SE3.exp(np.array([[0.0] * 6, [0.3, 0, 0, 0, 0, 0]])), np.array([0.5, 0.1, 4.0])
    camera = Camera((600.0, 600.0), (640.0, 480.0))
    z = camera.project(SE3.act(SE3.inverse(X), L[None]))[0]
    graph = FactorGraph([Projection(x[[0, 1]], l[0], z, UNIT, camera)])
    graph.fix(x[[0, 1]])
    return graph, Values({x: (SE3, X), l: (R(3), [start])}), L


@for_all(
    optimizer=[LevenbergMarquardt(), LevenbergMarquardt(damping=1e-9), Dogleg(), None],
    start=[[0.5, 0.1, 60.0], [0.0, 0.0, 30.0]],
)
def test_damped_methods_turn_back_from_a_step_behind_the_camera(
    start: list[float], optimizer: Optimizer | None
) -> None:
    """Depth is the inverse of what is measured: from too far away the full step overshoots, here through the camera."""
    graph, values, L = two_views(start)
    system = graph.linearize(values)
    step = np.linalg.lstsq(system.A.toarray(), system.b, rcond=None)[0]
    assert start[2] + step[2] < 0
    result = graph.optimize(values, optimizer)
    assert result.converged
    same(result.values[l[0]], L, atol=1e-6)
    chi2 = [iteration.chi2 for iteration in result.history]
    assert (np.diff(chi2) <= 0).all()
    assert result.method == ("dogleg" if isinstance(optimizer, Dogleg) else "levenberg-marquardt")


def test_an_undamped_step_behind_the_camera_is_said_so() -> None:
    graph, values, _ = two_views([0.5, 0.1, 60.0])
    result = graph.optimize(values, GaussNewton())
    assert result.status.name == "DIVERGED"
    assert "Projection(x0, l0): the point is behind the camera" in result.reason
    same(result.values[l[0]], [0.5, 0.1, 60.0])


@for_all(
    case=[
        (lambda: Projection(x[0], l[0], [0, 0], UNIT, o[0]), OptionError, "camera: o0"),
        (lambda: Projection(x[0], l[0], [0, 0], UNIT, None), OptionError, r"camera: None .*Camera\(focal="),
        (lambda: Projection(x[0], l[0:2], [0, 0, 0], UNIT), GraphError, r"\(u, v\): .* expected \(n, 2\)"),
        (lambda: Projection(x[0], l[0], [[0, 0]] * 3, UNIT), GraphError, "3 measurements for 1"),
        (lambda: Projection(o[0], l[0], [0, 0], UNIT), GraphError, "Projection: o0 is in SE2, this factor needs SE3"),
        (lambda: Projection(x[0], o[0], [0, 0], UNIT), GraphError, "target o0 is in SE2"),
        (lambda: Projection(x[0], l[0], [0, 0], UNIT, CAMERA, o[0]), GraphError, "offset o0 is in SE2"),
        (lambda: Projection(x[0], l[0], [0, 0], UNIT, CAMERA, [1, 2]), GraphError, "offset: SE3"),
        (lambda: Projection(x[0], l[0], [0, 0], Diagonal(x=1, y=2)), NoiseModelError, r"\['u', 'v'\]"),
        (lambda: Projection(x[0], l[0], [0, np.nan], UNIT), GraphError, r"Projection\(x0, l0\): .* not finite"),
    ]
)
def test_what_does_not_fit(case: tuple[Callable[[], Factor], type[Exception], str]) -> None:
    make, kind, named = case
    values = Values({x: (SE3, HERE), l: (R(3), [[0, 0, 5.0], [1, 0, 5]]), o: (SE2, [0.0, 0, 0])})
    refused(lambda: values.gather(make()), kind, named)
