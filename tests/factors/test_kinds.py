"""What one kind of factor refuses, or measures unless told, beside what the conformity suite asks of all."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, inf, nan, pi, sin
from typing import Any

import numpy as np
import pytest

import factors as f
from factors import DriftingStep, ElevationHinge, EpipolarArc, Factor, Heading, Position, Prior, Range, Wheels
from factors.bundle import CAMERA, LENS
from factors.replaced import replaced
from models import SE2, SE3, R, euler
from models.errors import GraphError, NoiseModelError, OptionError, SingularGeometryError
from nls import Values, kinds
from tests.combinations import for_all
from tests.factors.evaluated import error, linearized, refused, same

x, p, l, q, c, d = kinds("x", "p", "l", "q", "c", "d")
UNIT, HERE, STEP, PAIR = f.Isotropic(), SE3.identity()[0], [1.0, 0.0, 0.0], [4.0, 0.1, 3.9, 0.0]
VALUES = Values(
    {
        x: (SE3, SE3.identity(5)),
        p: (SE2, np.zeros((5, 3))),
        l: (R(3), np.ones((3, 3))),
        q: (R(2), np.ones((3, 2))),
        c: (R(1), np.zeros((3, 1))),
    }
)


LENGTHS = [[1.0], [1, -1], [1, nan], [[1], [1]], 1.0]
COMPASS = Heading(p[0:2], [0, 1], UNIT)
NO_MEASUREMENTS = [ElevationHinge(x[0], l[0], 0.1), Factor.from_function(np.array, x[0], 3), "compass"]
Z = r"components=\('z',\)$"
CASES: list[tuple[Callable[[Any], Factor], list[Any], type[Exception], str]] = [  # each of these arguments is refused
    (
        lambda names: Position(p[0], [1, 2], UNIT, names),
        [("x", "z"), (), ("x", "x"), ("yaw",)],
        GraphError,
        "components",
    ),
    (lambda i: Position(x[i], [1, 2], UNIT), [0, [0, 1]], GraphError, r"z has .*components=\('x', 'y'\)$"),
    (lambda z: Position(x[0], z, UNIT), [5.0, [5.0]], GraphError, Z),
    (lambda z: Position(x[0:4], z, UNIT), [[1] * 4, [[1]] * 4], GraphError, Z),
    (lambda z: Position(x[0:4], z, UNIT), [np.ones((4, 2))], GraphError, r"components=\('x', 'y'\)$"),
    (lambda z: Position(p[0:4], z, UNIT), [[[1]] * 4], GraphError, r"components=\('y',\)$"),
    (lambda z: Position(x[0], z, UNIT), [np.ones(4), np.ones((1, 4))], GraphError, r"expected \(n, 3\)"),
    (lambda O: f.BetweenSensors(p[0], p[1], STEP, UNIT, O), [STEP, np.zeros((2, 3))], GraphError, "pair of offsets"),
    (lambda form: f.XYH(x[0], x[1], STEP, UNIT, form), ["tilted", ["levelled"]], OptionError, "form: .*levelled or"),
    (lambda q_max: ElevationHinge(x[0], l[0], q_max), [7.0, "a", np.ones(2)], OptionError, "limit: "),
    (lambda s: ElevationHinge(x[0], l[0], 0.1, s), [0.0], OptionError, "ElevationHinge: softness: 0.0"),
    (lambda camera: f.Projection(x[0], l[0], [0, 0], UNIT, camera), [x[1], None], OptionError, "camera: "),
    (lambda q_max: EpipolarArc(x[0], x[1], PAIR, UNIT, q_max), [7.0, 0.0, "a", nan], OptionError, "limit"),
    (lambda z: EpipolarArc(x[0], x[1:3], z, UNIT, 0.1), [[PAIR, [5, 0, -4.9, 0]]], GraphError, r"x2.*\[5.0, -4.9\] m"),
    (lambda z: EpipolarArc(x[0], x[1:3], z, UNIT, 0.1), [[[0, 0, 4.9, 0], PAIR]], GraphError, r"x1.*\[0.0, 4.9\] m"),
    (
        lambda base: Wheels(p[0], p[1], [1, 1], UNIT, base),
        [0, -0.5, nan, inf, "a", None, True, [1]],
        OptionError,
        "base",
    ),
    (lambda z: Wheels(p[0], p[1], z, UNIT, 0.5), [1.0, [1.0], np.ones((2, 2, 2)), []], GraphError, r"\(n, 2\)"),
    (lambda z: DriftingStep(p[0], p[1], q[0], z, UNIT), [[1, 0], [], np.ones((2, 2, 3))], GraphError, r"\(n, 3\)"),
    (
        lambda n: DriftingStep(p[0:2], p[2:4], q[0], [STEP], UNIT, n),
        LENGTHS,
        GraphError,
        r"lengths .*, expected \(2,\)",
    ),
    (lambda z: DriftingStep(p[0:3], p[2:5], q[0], z, UNIT), [[STEP] * 2], GraphError, r"lengths.*\(2,\).*\(3,\)"),
    (lambda G: f.Shifted(COMPASS, G, c[0]), [np.ones((3, 1, 1)), [1.0]], GraphError, r"shape \("),
    (lambda G: f.Shifted(COMPASS, G, c[0]), [[[nan]], [[1], [1]]], GraphError, "finite|2 rows and it"),
    (lambda within: f.Shifted(within, [[1.0]], c[0]), NO_MEASUREMENTS, GraphError, "expected a factor that measures"),
    (
        lambda noise: f.ZPR(x[0], STEP, noise),
        [f.Diagonal(x=1, pitch=1, roll=1)],
        NoiseModelError,
        "'z', 'pitch', 'roll'",
    ),
]


@for_all(case=CASES)
def test_what_does_not_fit(case: tuple[Callable[[Any], Factor], list[Any], type[Exception], str]) -> None:
    make, arguments, kind, named = case
    for argument in arguments:
        refused(lambda argument=argument: VALUES.gather(make(argument)), kind, named)


OFFSETS: dict[str, tuple[Callable[..., Factor], object]] = {
    "Position": (lambda O: Position(p[0], [1, 2], UNIT, offset=O), [1.0, 2.0]),
    "Prior": (lambda O: Prior(p[0], STEP, UNIT, offset=O), STEP),
    "Range": (lambda O: Range(p[0], q[0], 1, UNIT, O), STEP),
    "Line": (lambda O: f.Line(p[0], q[0], [1, 2], UNIT, O), STEP),
    "ScaledRange": (lambda O: f.ScaledRange(p[0], q[0], c[0], 1, UNIT, O), STEP),
    "EpipolarArc": (lambda O: EpipolarArc(x[0], x[1], PAIR, UNIT, 0.1, O), HERE),
    "BetweenSensors": (lambda O: f.BetweenSensors(p[0], p[1], STEP, UNIT, (O, O)), STEP),
}
CONSTANTS: dict[str, tuple[Callable[..., Factor], object]] = {
    "length": (lambda numbers: DriftingStep(p[0], p[1], q[0], STEP, UNIT, numbers), [1.0]),
    "ways": (lambda numbers: f.DvlLeg(x[0], x[1], STEP, UNIT, numbers, c[0]), np.zeros((1, 3, 2))),
    "G": (lambda numbers: f.Shifted(Heading(p[0], 0.0, UNIT), numbers, c[0]), [[1.0]]),
}


@pytest.mark.parametrize("name", [*OFFSETS, *CONSTANTS])
def test_constants_are_numbers_and_stay_what_they_are(name: str) -> None:
    made, numbers = (OFFSETS | CONSTANTS)[name]
    attribute, given = "offset" if name in OFFSETS else name, np.array(numbers, dtype=float)
    kept = getattr(made(given), attribute)
    given += 1
    for array in kept if isinstance(kept, tuple) else (kept,):
        np.testing.assert_array_equal(array.ravel(), np.ravel(numbers))
        assert not array.flags.writeable
    refused(lambda: made(["bow"]), GraphError, f"its {attribute} is not an array of numbers: .*'bow'")
    if name not in ("Range", "Line"):
        refused(lambda: made(d[2]), GraphError, "a variable; here it must be known|d2 is a variable")
    if name in OFFSETS and name != "Line":
        for wrong, named in (
            (np.ones(9), "offset: .*9"),
            (np.tile(numbers, (2, 1)), "2 offsets for 1"),
            (given * nan, "finite"),
        ):
            refused(lambda wrong=wrong: VALUES.gather(made(wrong)), GraphError, named)


SEEN = Values(
    {
        x: (SE3, euler.to_se3([[0.0] * 6, [0, pi / 2, 0, 0, 0, 0], [0, 0, 0, 4 * cos(0.1), 0, 3 - 4 * sin(0.1)]])),
        p: (SE2, np.zeros((1, 3))),
        l: (R(3), [[5, 0, 1], [0, 0, 3], [0, 0, 0]]),
        q: (R(2), [[1.0, 0.0], [0.0, 0.0]]),
        c: (CAMERA, np.zeros((1, 6))),
        d: (LENS, [[100.0, 0.1, 0.0]]),
    }
)


@for_all(
    case=[
        (Heading(x[[0, 1]], [0.0, 0.0], UNIT), "gimbal lock"),
        (f.ZPR(x[[0, 1]], STEP, UNIT), "gimbal lock"),
        (f.XYH(x[[0, 1]], x[[2, 2]], STEP, UNIT), "gimbal lock"),
        (Range(p[[0, 0]], q[[0, 1]], 1, UNIT), "at the sensor"),
        (f.Bearing(x[[0, 0]], l[[0, 1]], [1, 1], UNIT), "z axis"),
        (f.BearingRange(p[[0, 0]], q[[0, 1]], [1, 1], UNIT), "zero range"),
        (f.RangeAzimuth(x[[0, 0]], l[[0, 1]], [1, 0], UNIT), "target is on"),
        (ElevationHinge(x[[0, 0]], l[[0, 1]], 0.1), "target is on"),
        (f.Projection(x[[0, 0]], l[[0, 2]], [0, 0], UNIT), "behind"),
        (f.BundleProjection(c[[0, 0]], d[0], l[[0, 2]], [0, 0], UNIT), "in the plane"),
        (EpipolarArc(x[[0, 0]], x[[2, 2]], [[2, 0.1, 3, 0], [4, 0, 3, 0]], UNIT, 0.1), "z axis"),
    ]
)
def test_singular_geometry_names_the_measurement(case: tuple[Factor, str]) -> None:
    factor, named = case
    for evaluate in (error, linearized):
        caught = refused(lambda evaluate=evaluate: evaluate(factor, SEEN), SingularGeometryError, named)
        assert (caught.factor, caught.keys) == (factor.name, tuple(keys[[1]] for keys in factor.keys))


def test_what_a_step_measures_unless_given() -> None:
    """No slip across of wheels; the length of the way that was reckoned."""
    slid = Values({x: (SE2, [[0.0, 0.0, 0.0], [1.0, 0.02, 0.0]])})
    for z, e in (([1.0, 1.0], -0.02), ([1.0, 1.0, 0.02], 0.0), ([[1.0, 1.0, 0.05]], 0.03)):
        wheels = Wheels(x[0], x[1], z, UNIT, 0.5)
        same(error(wheels, slid), [[0.0, 0.0, e]], atol=1e-14)
        same(error(Wheels(x[0], x[1], wheels.z, UNIT, 0.5), slid), [[0.0, 0.0, e]], atol=1e-14)
    z = [[3.0, 4.0, 0.1], [0.0, 0.0, 0.3]]
    for given, length, found in ((z, None, [5, 0]), (z, [4, 1], [4, 1]), (z[0], None, [5, 5])):  # one step for all
        same(DriftingStep(p[[0, 1]], p[[1, 2]], q[0], given, UNIT, length).length, found)


def test_as_many_numbers_as_coordinates_want_no_names() -> None:
    for pose, z in ((x[0], [1.0, 2.0, 3.0]), (p[0], [1.0, 2.0]), (x[0:3], np.ones((3, 3)))):
        assert error(Position(pose, z, UNIT), VALUES).shape == (len(pose), np.shape(z)[-1])
    assert error(Position(x[0], [1.0, 2.0], UNIT, components=("x", "y")), VALUES).tolist() == [[1.0, 2.0]]


def test_a_factor_within_another_follows_its_variables() -> None:
    shifted = f.Shifted(Position(p[0:2], np.zeros((2, 2)), UNIT), np.ones((2, 1)), c[0])
    other = replaced(shifted, keys=[p[[1, 0]], shifted.keys[1]])
    assert isinstance(other, f.Shifted)
    assert other.factor.keys == other.keys[:1]


class Stretched(f.Between):
    """An odometer that shows ten percent too much."""

    def predict(self, manifolds: Any, *X: Any) -> Any:
        h = super().predict(manifolds, *X)[0].copy()
        h[:, :2] *= 1.1
        return h, None


@pytest.mark.parametrize("convention", ["g2o", "log"])
def test_a_subclass_of_between_predicts_by_itself(convention: str) -> None:
    values = Values({x: (SE2, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])})
    odometer = Stretched(x[0], x[1], [[1.1, 0.0, 0.0]], f.Isotropic(0.1), convention)
    assert odometer.chi2(values) == pytest.approx([0.0], abs=1e-20)
    assert f.Between(x[0], x[1], [[1.1, 0.0, 0.0]], f.Isotropic(0.1), convention).chi2(values) == pytest.approx([1.0])
