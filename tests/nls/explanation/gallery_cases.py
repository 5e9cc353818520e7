"""Broken on purpose: what measurements leave free and what is too large; and all chapters."""

from __future__ import annotations

from tests.nls.explanation.gallery import Case
from tests.nls.explanation.gallery_data import DATA
from tests.nls.explanation.gallery_files import FILES
from tests.nls.explanation.gallery_geometry import GEOMETRY
from tests.nls.explanation.gallery_missions import MISSIONS
from tests.nls.explanation.gallery_python import PYTHON

__all__ = ["CHAPTERS", "FREE"]

FREE = (
    Case(
        "Nothing holds the graph",
        """
graph = FactorGraph([chain])
graph.optimize(values, gauge="none")
""",
        "UnderconstrainedError",
        ("3 directions free", "x, y, yaw of all 5 variables joined to x0", "add a prior"),
        """
graph.add(Prior(x[0], [0.0, 0.0, 0.0], noise))
result = graph.optimize(values, gauge="none")
""",
    ),
    Case(
        "Two parts that no measurement joins, one of them held",
        """
graph = FactorGraph([
    Prior(x[0], [0.0, 0.0, 0.0], noise),
    Between(x[[0, 1, 3]], x[[1, 2, 4]], [1.0, 0.0, 0.0], noise),
])
graph.optimize(values, gauge="none")
""",
        "UnderconstrainedError",
        ("all 2 variables joined to x3", "add a measurement between the parts"),
        """
graph.add(Between(x[2], x[3], [1.0, 0.0, 0.0], noise))
result = graph.optimize(values, gauge="none")
""",
    ),
    Case(
        "A track cut in two by leaving one measurement out",
        """
graph = FactorGraph([chain[[0, 1, 3]]])  # without x2 to x3
result = graph.optimize(values)  # nothing is refused: the gauge of each part is held
said = f"gauge: {result.gauge}"
""",
        "",
        ("x0, x3 held",),
        """
graph.add(chain[[2]])
result = graph.optimize(values)
assert result.gauge == "x0 held"
""",
        explained=("separate_parts", "x0 x3", "join split"),
    ),
    Case(
        "A variable that no factor touches",
        """
values = Values({x: (SE2, SE2.identity(6))})
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), chain])
result = graph.optimize(values)
""",
        "GraphWarning",
        ("x5", "no measurement touches", "held"),
        """
graph.add(Between(x[4], x[5], [1.0, 0.0, 0.0], noise))
result = graph.optimize(values)
""",
    ),
    Case(
        "A landmark whose range was measured once",
        """
values = Values({x: (SE2, [[0.0, 0, 0], [1, 0, 0]]), l: (R(2), [[2.0, 3.0]])})
graph = FactorGraph([Prior(x[[0, 1]], values[x], noise), Range(x[0], l[0], [3.6], Isotropic(0.1))])
graph.optimize(values)
""",
        "UnderconstrainedError",
        ("1 direction free", "l0: x, y", "see a landmark from another place"),
        """
graph.add(Range(x[1], l[0], [3.2], Isotropic(0.1)))
result = graph.optimize(values)
""",
        explained=("free", "l0", "spread ranges measure"),
    ),
    Case(
        "A landmark whose bearing was measured once",
        """
values = Values({x: (SE2, [[0.0, 0, 0], [1, 0, 0]]), l: (R(2), [[2.0, 3.0]])})
graph = FactorGraph([Prior(x[[0, 1]], values[x], noise), Bearing(x[0], l[0], [0.98], Isotropic(0.01))])
graph.optimize(values)
""",
        "UnderconstrainedError",
        ("1 direction free", "l0: x, y", "see a landmark from another place"),
        """
graph.add(Bearing(x[1], l[0], [1.25], Isotropic(0.01)))
result = graph.optimize(values)
""",
        explained=("free", "l0", "second place measure"),
    ),
    Case(
        "A component that nothing measures",
        """
graph = FactorGraph([chain, Prior(x[0], [0.0, 0.0, 0.0], Isotropic(0.1), components=("x", "y"))])
graph.optimize(values)
""",
        "UnderconstrainedError",
        ("1 direction free", "yaw", "x0"),
        """
graph.add(Prior(x[0], [0.0, 0.0, 0.0], Isotropic(0.02), components=("yaw",)))
result = graph.optimize(values)
""",
        explained=("free", "x0", "prior measure fix"),
    ),
    Case(
        "Fewer measurements than unknowns, and a method that would not notice",
        """
graph = FactorGraph([Range(x[0], l[0], [3.6], Isotropic(0.1))])
start = Values({x: (SE2, SE2.identity(1)), l: (R(2), [[2.0, 3.0]])})
graph.fix(x[0])
graph.optimize(start, LevenbergMarquardt())
""",
        "UnderconstrainedError",
        ("l0",),
        """
graph.add(Bearing(x[0], l[0], [0.98], Isotropic(0.01)))
result = graph.optimize(start, LevenbergMarquardt())
""",
    ),
    Case(
        "A prior a billion times weaker than the rest",
        """
graph = FactorGraph([chain, Prior(x[0], [0.0, 0.0, 0.0], Isotropic(1e9))])
graph.optimize(values)
""",
        "UnderconstrainedError",
        ("x0", "Prior(x0)", "sigma 1e+09", "give it a smaller sigma", "tighten", "nls.QR()"),
        """
graph = FactorGraph([chain, Prior(x[0], [0.0, 0.0, 0.0], Isotropic(1e-3))])
result = graph.optimize(values)
""",
    ),
    Case(
        "A covariance where nothing was measured",
        """
values = Values({x: (SE2, SE2.identity(6))})
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), chain])
marginals = nls.Marginals(graph, values)
marginals.covariance(x[5], frame="body")
""",
        "UnderconstrainedError",
        ("x5", "no measurement touches it"),
        """
Sigma = marginals.covariance(x[4], frame="body")
assert Sigma.shape == (3, 3)
""",
    ),
)

SIZE = (
    Case(
        "A dense solver on a large graph",
        """
n = np.arange(20000)
graph = FactorGraph([Between(x[n], x[n + 1], [1.0, 0.0, 0.0], noise)])
large = Values({x: (SE2, SE2.identity(20001))})
graph.optimize(large, linear_solver=nls.DenseQR())
""",
        "ResourceLimitError",
        ("'dense-qr'", "60000 x 60000", "GB", "sparse solver"),
        """
result = graph.optimize(large)
""",
    ),
    Case(
        "A sparse factorization above the limit",
        """
n = np.arange(900).reshape(30, 30)
j, k = np.append(n[1:], n[:, 1:]), np.append(n[:-1], n[:, :-1])
grid = Between(p[j], p[k], [0.0, 0.0, 0.0], Isotropic(0.1))
large = Values({p: (R(3), np.zeros((900, 3)))})
FactorGraph([grid]).optimize(large, linear_solver=nls.LU(memory_limit=1e6))
""",
        "ResourceLimitError",
        ("'lu'", "2,697 unknowns", "the limit is 0.00100 GB", "memory_limit"),
        """
result = FactorGraph([grid]).optimize(large, linear_solver=nls.LU(memory_limit=1e9))
""",
    ),
)

CHAPTERS = {
    "What the measurements leave free": FREE,
    "What their geometry leaves free": GEOMETRY,
    "Measurements, weights and starts that are wrong": DATA,
    "Graphs made in Python": PYTHON,
    "Too large": SIZE,
    "Files": FILES,
    "Mission folders": MISSIONS,
}
