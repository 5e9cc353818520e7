"""Broken on purpose: factors, noises, options and values that do not fit."""

from __future__ import annotations

from tests.nls.explanation.gallery import Case

__all__ = ["PYTHON"]

PYTHON = (
    Case(
        "A variable without a value",
        """
graph = FactorGraph([chain, Between(x[4], x[7], [1.0, 0.0, 0.0], noise)])
graph.optimize(values)
""",
        "GraphError",
        ("x7 has no value", "x0 to x4"),
        """
values = Values({x: (SE2, SE2.identity(6), [0, 1, 2, 3, 4, 7])})
result = graph.optimize(values)
""",
    ),
    Case(
        "A kind of variable without a value",
        """
graph = FactorGraph([chain, Range(x[0], l[0], [3.6], Isotropic(0.1))])
graph.optimize(values)
""",
        "GraphError",
        ("l", "Values hold", "x"),
    ),
    Case(
        "A measurement of the wrong shape",
        """
graph = FactorGraph([Between(x[0], x[1], [1.0, 0.0], noise)])
graph.optimize(values)
""",
        "GraphError",
        ("Between(x0, x1)", "(2,)", "3"),
        """
graph = FactorGraph([Between(x[0], x[1], [1.0, 0.0, 0.0], noise)])
result = graph.optimize(Values({x: (SE2, SE2.identity(2))}))
""",
    ),
    Case(
        "Variables in another space than the factor needs",
        """
graph = FactorGraph([Range(x[0], l[0], [3.6], Isotropic(0.1))])
graph.optimize(Values({x: (SE2, SE2.identity(1)), l: (R(3), [[2.0, 3.0, 0.0]])}))
""",
        "GraphError",
        ("R(3)", "R(2)"),
    ),
    Case(
        "Sigmas for another number of components",
        """
graph = FactorGraph([Between(x[0], x[1], [1.0, 0.0, 0.0], Diagonal([0.1, 0.1]))])
graph.optimize(values)
""",
        "NoiseModelError",
        ("Between(x0, x1)", "2 sigmas", "3 components", "'yaw'"),
        """
graph = FactorGraph([Between(x[0], x[1], [1.0, 0.0, 0.0], Diagonal([0.1, 0.1, 0.02]))])
result = graph.optimize(Values({x: (SE2, SE2.identity(2))}))
""",
    ),
    Case(
        "A sigma that is negative",
        """
graph = FactorGraph([Between(x[i], x[i + 1], [1.0, 0.0, 0.0], Isotropic([0.1, 0.1, -0.1, 0.1]))])
graph.optimize(values)
""",
        "NoiseModelError",
        ("Between(x2, x3)", "measurement 2", "-0.1", "> 0"),
        """
graph = FactorGraph([Between(x[i], x[i + 1], [1.0, 0.0, 0.0], Isotropic([0.1, 0.1, 0.1, 0.1]))])
result = graph.optimize(values)
""",
    ),
    Case(
        "A covariance that is none",
        """
Sigma = [[0.01, 0.02, 0.0], [0.02, 0.01, 0.0], [0.0, 0.0, 0.01]]  # correlated by more than 1
graph = FactorGraph([Between(x[0], x[1], [1.0, 0.0, 0.0], Covariance(Sigma))])
graph.optimize(values)
""",
        "NoiseModelError",
        ("Between(x0, x1)", "not positive definite", "-0.01"),
        """
Sigma = [[0.01, 0.002, 0.0], [0.002, 0.01, 0.0], [0.0, 0.0, 0.01]]
graph = FactorGraph([Between(x[0], x[1], [1.0, 0.0, 0.0], Covariance(Sigma))])
result = graph.optimize(Values({x: (SE2, SE2.identity(2))}))
""",
    ),
    Case(
        "A pose joined to itself",
        """
Between(x[[0, 1, 2]], x[[1, 1, 3]], [1.0, 0.0, 0.0], noise)
""",
        "GraphError",
        ("measurement 1 joins x1 to itself",),
    ),
    Case(
        "A residual that is not a number",
        """
def speed(X):
    return np.sqrt(X[:, :1] - 1.0) - 1.0

graph = FactorGraph([Factor.from_function(speed, p[0], dim=1)])
start = Values({p: (R(1), [[0.5]])})
with np.errstate(invalid="ignore"):
    graph.optimize(start)
""",
        "EvaluationError",
        ("speed(p0)", "residual is not finite", "nan"),
        """
start[p[0]] = [2.0]
result = graph.optimize(start)
""",
    ),
    Case(
        "A Jacobian of the wrong sign",
        """
def residual(X):
    return np.stack([X[:, 0] ** 2 - 2.0, X[:, 0] - 1.0], axis=1)

def right(X):
    return [np.stack([2 * X[:, 0], np.ones(len(X))], axis=1)[:, :, None]]

def wrong(X):
    return [-right(X)[0]]

factor = Factor.from_function(residual, p[0], dim=2, jacobians=wrong)
start = Values({p: (R(1), [[3.0]])})
said = FactorGraph([factor]).optimize(start, LevenbergMarquardt()).reason
""",
        "",
        ("every step was refused", "check_jacobians"),
        """
try:
    check_jacobians(factor, start)
except nls.JacobianError as error:
    assert "likely: the sign is flipped" in str(error)
graph = FactorGraph([Factor.from_function(residual, p[0], dim=2, jacobians=right)])
result = graph.optimize(start, LevenbergMarquardt())
""",
    ),
    Case(
        "A landmark in space, seen by a vehicle of the plane",
        """
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), Landmark(x[0], l[0], [1.0, 2.0, 0.5], Isotropic(0.1))])
graph.optimize(Values({x: (SE2, SE2.identity(1)), l: (R(2), [[1.0, 2.0]])}))
""",
        "GraphError",
        ("Landmark(x0, l0)", "(3,)", "2"),
        """
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), Landmark(x[0], l[0], [1.0, 2.0], Isotropic(0.1))])
result = graph.optimize(Values({x: (SE2, SE2.identity(1)), l: (R(2), [[1.0, 2.0]])}))
""",
    ),
    Case(
        "A number of a variable that is no whole number",
        "Prior(x[0.5], [0.0, 0.0, 0.0], noise)\n",
        "GraphError",
        ("whole numbers", "0.5"),
    ),
    Case(
        "A covariance of a pose, and nobody said along whose axes",
        """
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), chain])
nls.Marginals(graph, values).covariance(x[4])
""",
        "OptionError",
        ("frame", "body", "world"),
        """
Sigma = nls.Marginals(graph, values).covariance(x[4], frame="world")
assert Sigma.shape == (3, 3)
""",
    ),
    Case(
        "An option that does not exist",
        """
FactorGraph([chain]).optimize(values, gauge="fixed")
""",
        "OptionError",
        ("gauge", "'fixed'", "first", "prior", "free", "none"),
        """
result = FactorGraph([chain]).optimize(values, gauge="first")
""",
    ),
)
