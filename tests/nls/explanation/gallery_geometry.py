"""Broken on purpose: geometry that leaves something free, however often it is measured."""

from __future__ import annotations

from tests.nls.explanation.gallery import Case

__all__ = ["GEOMETRY"]

GEOMETRY = (
    Case(
        "A sonar that flies level over a stone at its own depth",
        """
X = SE3.exp([[s, 0, 0, 0, 0, 0] for s in (0.0, 0.5, 1.0)])  # surge
z = [[5.0, 0.06], [4.5, 0.067], [4.0, 0.075]]  # range and azimuth
graph = FactorGraph([RangeAzimuth(x[:3], l[7], z, Isotropic(0.01))])
graph.fix(x[[0, 1, 2]])
graph.optimize(Values({x: (SE3, X), l: (R(3), [[5.0, 0.3, 0.0]], [7])}))
""",
        "UnderconstrainedError",
        ("factors that do not react to a change here: l7: z", "measure the component", "zero at these values alone"),
        """
deeper = SE3.exp([[1, 0, 0.5, 0, 0, 0]])  # heave
values = Values({x: (SE3, [*X, *deeper]), l: (R(3), [[5.0, 0.3, 0.0]], [7])})
graph.add(RangeAzimuth(x[3], l[7], [4.043, 0.075], Isotropic(0.01)))
graph.fix(x[3])
result = graph.optimize(values)
""",
        explained=("free", "l7", "roll aperture"),
    ),
    Case(
        "A sonar that only turns on the spot",
        """
X = SE3.exp([[0, 0, 0, 0, 0, yaw] for yaw in (0.0, 0.1, 0.2)])
z = [[5.0, 0.06], [5.0, -0.04], [5.0, -0.14]]
graph = FactorGraph([RangeAzimuth(x[:3], l[7], z, Isotropic(0.01))])
graph.fix(x[[0, 1, 2]])
graph.optimize(Values({x: (SE3, X), l: (R(3), [[5.0, 0.3, 0.4]], [7])}))
""",
        "UnderconstrainedError",
        ("1 direction free", "l7: x, z", "see a landmark from another place"),
        """
rolled = SE3.exp([[0, 0, 0, 0.3, 0, 0]])  # by 17 degrees
values = Values({x: (SE3, [*X, *rolled]), l: (R(3), [[5.0, 0.3, 0.4]], [7])})
graph.add(RangeAzimuth(x[3], l[7], [5.0, 0.07], Isotropic(0.01)))
graph.fix(x[3])
result = graph.optimize(values, LevenbergMarquardt())
""",
        explained=("free", "l7", "roll aperture"),
    ),
    Case(
        "A camera that only turns",
        """
X = SE3.exp([[0, 0, 0, 0, turn, 0] for turn in (0.0, 0.1, 0.2)])
z = [[0.06, 0.04], [-0.04, 0.04], [-0.14, 0.04]]
graph = FactorGraph([Projection(x[:3], l[0], z, Isotropic(0.001))])
graph.fix(x[[0, 1, 2]])
values = Values({x: (SE3, X), l: (R(3), [[0.3, 0.2, 5.0]])})
result = graph.optimize(values)  # by damped steps: nothing is raised
said = str(result).splitlines()[-1]
""",
        "",
        ("free, left where the start had them: l0: x, y, z",),
        """
aside = SE3.exp([[1, 0, 0, 0, 0, 0]])
values = Values({x: (SE3, [*X, *aside]), l: (R(3), [[0.3, 0.2, 5.0]])})
graph.add(Projection(x[3], l[0], [-0.14, 0.04], Isotropic(0.001)))
graph.fix(x[3])
result = graph.optimize(values)
assert not result.underconstrained
""",
        explained=("free", "l0", "second place measure"),
    ),
    Case(
        "Images alone have no scale",
        """
X = SE3.exp([[0, 0, 0, 0, 0, 0], [1, 0, 0, 0, -0.2, 0]])
L = np.array([[0, 0, 5.0], [1, 1, 6], [-1, 1, 4], [-1, -1, 5], [1, -1, 4], [0, 1, 7], [1, 0, 5]])
pose, point = np.repeat([0, 1], 7), np.tile(np.arange(7), 2)
p = SE3.act(SE3.inverse(X[pose]), L[point])
graph = FactorGraph([Projection(x[pose], l[point], p[:, :2] / p[:, 2:], Isotropic(0.001))])
values = Values({x: (SE3, X), l: (R(3), L)})
graph.optimize(values, GaussNewton())
""",
        "UnderconstrainedError",
        ("1 direction free", "x1: x", "l0: z"),
        """
graph.add(Range(x[0], l[0], [5.0], Isotropic(0.05)))  # one distance
result = graph.optimize(values, GaussNewton())
""",
        explained=("free", "x0", "distance"),
    ),
    Case(
        "Bearings alone have no scale",
        """
X = np.array([[0.0, 0, 0], [2, 0, 0], [1, 1, 0]])
L = np.array([[1.0, 3], [2, 4], [0, 3], [3, 2], [-1, 2]])
pose, point = np.repeat([0, 1, 2], 5), np.tile(np.arange(5), 3)
seen = SE2.act(SE2.inverse(X[pose]), L[point])
graph = FactorGraph([Bearing(x[pose], l[point], np.arctan2(seen[:, 1], seen[:, 0]), Isotropic(0.01))])
values = Values({x: (SE2, X), l: (R(2), L)})
graph.optimize(values)
""",
        "UnderconstrainedError",
        ("1 direction free", "x1: x", "l0: x, y"),
        """
graph.add(Between(x[0], x[1], [2.0, 0.0, 0.0], noise))  # how far it went, once
result = graph.optimize(values)
""",
        explained=("free", "x0", "distance"),
    ),
    Case(
        "Ranges from one straight line",
        """
at = np.arange(5)
X = SE2.exp([[s, 0, 0] for s in at])
graph = FactorGraph([Range(x[at], l[0], np.hypot(at - 2.5, 2.0), Isotropic(0.1))])
graph.fix(x[at])
start = Values({x: (SE2, X), l: (R(2), [[2.5, 0.0]])})  # on the line
graph.optimize(start)
""",
        "UnderconstrainedError",
        ("factors that do not react to a change here: l0: y", "zero at these values alone"),
        """
graph.add(Bearing(x[0], l[0], [0.67], Isotropic(0.05)))  # to the left
result = graph.optimize(start)
assert np.allclose(result.values[l[0]], [2.5, 2.0], atol=0.1)
""",
        explained=("free", "l0", "spread ranges measure"),
    ),
    Case(
        "A pose in space that sees landmarks of one line",
        """
L = np.array([[2.0, 0, 0], [3, 0, 0], [5, 0, 0], [6, 0, 0]])
graph = FactorGraph([Landmark(x[0], l[:4], L, Isotropic(0.01))])
graph.fix(l[:4])
graph.optimize(Values({x: (SE3, SE3.identity(1)), l: (R(3), L)}))
""",
        "UnderconstrainedError",
        ("do not react to a change here: x0: roll", "measure the component"),
        """
values = Values({x: (SE3, SE3.identity(1)), l: (R(3), [*L, [2, 3, 0]])})
graph.add(Landmark(x[0], l[4], [2, 3, 0], Isotropic(0.01)))  # one beside the line
graph.fix(l[4])
result = graph.optimize(values)
""",
        explained=("free", "x0", "measure prior fix"),
    ),
    Case(
        "A mounting to be found by a vehicle that never turns",
        """
(c,) = nls.kinds("c")  # the pose of the sensor on the vehicle
X, mounting = SE2.exp([[s, 0, 0] for s in range(3)]), np.array([[0.3, 0.1, 0.2]])
S = SE2.compose(X, mounting)  # the sensor measures its own motion
z = SE2.between(S[:-1], S[1:])
graph = FactorGraph([BetweenSensors(x[[0, 1]], x[[1, 2]], z, noise, c[0])])
graph.fix(x[:3])
graph.optimize(Values({x: (SE2, X), c: (SE2, mounting)}))
""",
        "UnderconstrainedError",
        ("do not react to a change here: c0: x, y", "measure the component"),
        """
X = np.vstack([X, [[2.0, 1.0, 1.5]]])
S = SE2.compose(X, mounting)
turn = SE2.between(S[2:3], S[3:])
graph.add(BetweenSensors(x[2], x[3], turn, noise, c[0]))
graph.fix(x[3])
result = graph.optimize(Values({x: (SE2, X), c: (SE2, SE2.identity(1))}))
assert np.allclose(result.values[c], mounting, atol=1e-6)
""",
        explained=("free", "c0", "measure prior fix"),
    ),
    Case(
        "A pitch of 90 degrees",
        """
up = SE3.exp([[0, 0, 2.0, 0, np.pi / 2, 0]])
tilt = ZPR(x[0], [2.0, np.pi / 2, 0.0], Isotropic(0.01))
graph = FactorGraph([Prior(x[0], up, Isotropic(0.1)), tilt])
graph.optimize(Values({x: (SE3, up)}))
""",
        "SingularGeometryError",
        ("ZPR(x0)", "gimbal lock (pitch = +-90 deg)", "by a Prior"),
        """
graph = FactorGraph([Prior(x[0], up, Isotropic(0.01))])  # one rotation, no angles
result = graph.optimize(Values({x: (SE3, up)}))
""",
    ),
    Case(
        "A target at the place of the sensor",
        """
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), Range(x[0], l[0], [3.6], Isotropic(0.1))])
start = Values({x: (SE2, SE2.identity(1)), l: (R(2), [[0.0, 0.0]])})
graph.optimize(start)
""",
        "SingularGeometryError",
        ("x0", "l0"),
        """
graph.add(Bearing(x[0], l[0], [0.98], Isotropic(0.01)))
start[l[0]] = [1.0, 1.0]
result = graph.optimize(start)
""",
    ),
    Case(
        "A point behind the camera",
        """
z = [[0.25, 0.0], [0.0, 0.0]]
graph = FactorGraph([Projection(x[[0, 1]], l[0], z, Isotropic(0.001))])
X = SE3.exp([[0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]])
values = Values({x: (SE3, X), l: (R(3), [[0.0, 0.0, -4.0]])})
graph.fix(x[[0, 1]])
graph.optimize(values)
""",
        "SingularGeometryError",
        ("Projection(x0, l0)", "behind the camera", "check the start values of pose and point"),
        """
values[l[0]] = [0.0, 0.0, 2.0]
result = graph.optimize(values)
assert np.allclose(result.values[l[0]], [1.0, 0.0, 4.0], atol=1e-4)
""",
    ),
    Case(
        "A straight track, aligned with the truth",
        """
from nls.metrics import ate

truth = SE3.exp([[s, 0, 0, 0, 0, 0] for s in range(5)])
ate(SE3.compose([0, 0, 1, 0, 0, 0, 1], truth), truth, align="rigid")
""",
        "SingularGeometryError",
        ("5 positions on one line do not determine the rotation", "align='first'"),
        """
error = ate(SE3.compose([0, 0, 1, 0, 0, 0, 1], truth), truth, align="first")
assert error.rmse < 1e-12
""",
    ),
)
