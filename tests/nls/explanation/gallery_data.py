"""Broken on purpose: measurements that are wrong, count twice, or are given the wrong weight, and starts from afar."""

from __future__ import annotations

from tests.nls.explanation.gallery import Case

__all__ = ["DATA"]

WALK = """
n = np.arange(20)  # around a square of four meters, and on
X = SE2.stack([[0, 0, 0]])
for k in n:
    X = np.vstack([X, SE2.compose(X[-1:], np.array([1.0, 0, np.pi / 2 if k % 4 == 3 else 0]))])
walk = Between(x[n], x[n + 1], SE2.between(X[:-1], X[1:]), noise)
values = Values({x: (SE2, X)})
"""

DATA = (
    Case(
        "Bearings in degrees",
        "Bearing(x[[0, 1]], l[0], [45.0, 63.4], Isotropic(0.01))\n",
        "GraphError",
        ("Bearing(x0, l0): its bearing is 45 rad", "expected radians", "np.radians(z)"),
        """
seen = Bearing(x[[0, 1]], l[0], np.radians([45.0, 63.4]), Isotropic(0.01))
graph = FactorGraph([seen])
graph.fix(x[[0, 1]])
result = graph.optimize(Values({x: (SE2, [[0, 0, 0], [1, 0, 0]]), l: (R(2), [[2.2, 2.1]])}))
""",
    ),
    Case(
        "An angle that nobody wrapped",
        """
X = SE2.stack([[s, 0, 0] for s in range(6)])
z = [3.13, -3.13, 3.14, 3.13, -3.14, -3.13]  # of a buoy right astern

def minus(X, l):
    d = l - X[:, :2]
    return (np.arctan2(d[:, 1], d[:, 0]) - X[:, 2] - z)[:, None]

buoy = Prior(l[0], [-8.0, 0.0], Isotropic(0.1))
bearings = Factor.from_function(minus, [x[:6], l[[0] * 6]], 1, Isotropic(0.01))
graph = FactorGraph([buoy, bearings])
graph.fix(x[:6])
values = Values({x: (SE2, X), l: (R(2), [[-8.0, 0.0]])})
result = graph.optimize(values, LevenbergMarquardt())
said = result.doubt
""",
        "",
        ("times its expectation",),
        """
bearings = Bearing(x[:6], l[0], z, Isotropic(0.01))  # it wraps the difference
graph = FactorGraph([buoy, bearings])
graph.fix(x[:6])
result = graph.optimize(values)
assert result.chi2_final < 6
""",
        explained=("turn", "x1 l0", "wrap"),
    ),
    Case(
        "A loop closure between two places that only look alike",
        """
truth = SE2.stack([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]])
graph = FactorGraph([Prior(x[0], truth[:1], noise), chain, Between(x[0], x[4], [0.0, 0.0, 3.0], noise)])
result = graph.optimize(Values({x: (SE2, truth)}))
said = result.doubt
""",
        "",
        ("times its expectation", "outliers"),
        """
graph = graph.robust(Cauchy(1.0))
result = graph.optimize(Values({x: (SE2, truth)}))
assert graph.factors[2].weights(result.values)[0] < 0.01  # switched off
assert np.abs(result.values[x] - truth).max() < 0.05
""",
        explained=("wrong_closure", "x0 x4", "inspect remove robust"),
    ),
    Case(
        "A loop closure the wrong way round",
        WALK
        + """
z = SE2.between(X[[0, 1, 0]], X[[16, 17, 18]])
closures = Between(x[[0, 1, 18]], x[[16, 17, 0]], z, noise)
graph = FactorGraph([walk, closures])
result = graph.optimize(values)
said = str(result).splitlines()[-1]
""",
        "",
        ("ratio 59.3, 1 expected",),
        """
closures = Between(x[[0, 1, 0]], x[[16, 17, 18]], z, noise)
result = FactorGraph([walk, closures]).optimize(values)
assert result.chi2_final < 1e-9
""",
        explained=("wrong_closure", "x18 x0", "swap"),
    ),
    Case(
        "An odometry that turns the wrong way",
        """
n = np.arange(40)
walk = np.tile([1.0, 0.0, 0.1], (40, 1))  # around a circle to the left
compass = Heading(x[np.append(n, 40)], 0.1 * np.append(n, 40), Isotropic(0.05))
mirrored = Between(x[n], x[n + 1], walk * [1, 1, -1], noise)
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), mirrored, compass])
values, *_ = nls.initialize(graph, Values({x: (SE2, SE2.identity(41))}))
result = graph.optimize(values)
said = result.doubt
""",
        "",
        ("times its expectation",),
        """
left = Between(x[n], x[n + 1], walk, noise)
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), left, compass])
start, *_ = nls.initialize(graph, values)
result = graph.optimize(start)
assert result.chi2_final < 1e-9
""",
        explained=("systematic", "", "frames start"),
    ),
    Case(
        "Two landmarks taken for each other, once",
        """
at, seen = np.repeat(np.arange(5), 3), np.tile(np.arange(3), 5)
X, L = np.array([[s, 0.0, 0] for s in range(5)]), np.array([[1.0, 2], [2, 2], [3, 2]])
z = SE2.act(SE2.inverse(X[at]), L[seen])
named = seen.copy()
named[[6, 7]] = 1, 0  # from x2
graph = FactorGraph([Prior(x[0], X[:1], noise), chain, Landmark(x[at], l[named], z, Isotropic(0.05))])
values = Values({x: (SE2, X), l: (R(2), L)})
result = graph.optimize(values)
said = str(result).splitlines()[-1]
""",
        "",
        ("ratio 26.7, 1 expected",),
        """
graph = FactorGraph([Prior(x[0], X[:1], noise), chain, Landmark(x[at], l[seen], z, Isotropic(0.05))])
result = graph.optimize(values)
assert result.chi2_final < 1e-9
""",
        explained=("outlier", "x2 l0", "inspect remove robust"),
    ),
    Case(
        "One landmark under two numbers",
        """
X, stone = SE2.stack([[s, 0, 0] for s in range(5)]), np.array([[2.0, 3.0]])
at, z = np.array([0, 1, 3, 4]), [[2.02, 3.05], [0.96, 2.94], [-0.93, 3.06], [-2.05, 3.02]]
graph = FactorGraph([Prior(x[0], X[0], noise), chain, Landmark(x[at], l[[0, 0, 1, 1]], z, Isotropic(0.05))])
result = graph.optimize(Values({x: (SE2, X), l: (R(2), [*stone, *stone])}))
said = nls.explain(graph, result.values).report().splitlines()[0]
""",
        "",
        ("19 unknowns, all determined", "is as expected"),
        """
P = nls.Marginals(graph, result.values).joint(l[[0, 1]]).matrix
S = P[:2, :2] + P[2:, 2:] - P[:2, 2:] - P[2:, :2]  # ask: may the two be one?
gap = result.values[l[0]] - result.values[l[1]]
assert gap @ np.linalg.solve(S, gap) < 9.2  # 99 % of two degrees of freedom
graph = FactorGraph([Prior(x[0], X[0], noise), chain, Landmark(x[at], l[0], z, Isotropic(0.05))])
result = graph.optimize(Values({x: (SE2, X), l: (R(2), stone)}))
""",
    ),
    Case(
        "A loop closure that counts twice",
        """
closure = Between(x[0], x[4], [4.1, 0.0, 0.0], noise)
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), chain, closure, closure])
result = graph.optimize(values)
said = str(result).splitlines()[-1]
twice = nls.Marginals(graph, result.values).covariance(x[4], frame="body")
""",
        "",
        ("6 degrees of freedom",),
        """
graph.remove(closure)
result = graph.optimize(values)
once = nls.Marginals(graph, result.values).covariance(x[4], frame="body")
assert (np.diag(twice) < 0.9 * np.diag(once)).all()  # it claimed to know more than it did
""",
        explained=("repeated", "x0 x4", "remove copies"),
    ),
    Case(
        "Variances where standard deviations are meant",
        """
rng, (a, b) = np.random.default_rng(0), np.triu_indices(12, 1)  # each pose measured from each
X, sigma = SE2.exp(rng.standard_normal((12, 3))), np.array([0.1, 0.1, 0.02])
z = SE2.retract(SE2.between(X[a], X[b]), sigma * rng.standard_normal((66, 3)))
graph = FactorGraph([Between(x[a], x[b], z, Diagonal(sigma**2))])
result = graph.optimize(Values({x: (SE2, X)}))
said = result.doubt
""",
        "",
        ("times its expectation", "wrong sigmas"),
        """
graph = FactorGraph([Between(x[a], x[b], z, Diagonal(sigma))])
result = graph.optimize(Values({x: (SE2, X)}))
assert 0.8 < result.chi2_final / result.dof < 1.2
""",
        explained=("systematic", "", "frames start certify gnc"),
    ),
    Case(
        "Information of half an angle, given to a whole one",
        """
rng, (a, b) = np.random.default_rng(0), np.triu_indices(12, 1)
X = SE3.exp(rng.standard_normal((12, 6)))
z = SE3.retract(SE3.between(X[a], X[b]), 0.1 * rng.standard_normal((66, 6)))
Omega = Information(np.diag([100, 100, 100, 400, 400, 400]))  # as in a g2o file
graph = FactorGraph([Between(x[a], x[b], z, Omega)])
result = graph.optimize(Values({x: (SE3, X)}))
said = str(result).splitlines()[-1]
""",
        "",
        ("330 degrees of freedom", "1 expected"),
        """
graph = FactorGraph([Between(x[a], x[b], z, Omega, convention="g2o")])
result = graph.optimize(Values({x: (SE3, X)}))
assert 0.8 < result.chi2_final / result.dof < 1.2
""",
        explained=("sigmas", "", "larger sigmas"),
    ),
    Case(
        "A covariance along the axes of the world, where those of the body are meant",
        """
rng, (a, b) = np.random.default_rng(0), np.triu_indices(12, 1)
X = SE2.stack([[0, s, np.pi / 2] for s in range(12)])  # going north
z = SE2.retract(SE2.between(X[a], X[b]), [0.02, 0.3, 0.01] * rng.standard_normal((66, 3)))
Sigma = np.diag([0.3, 0.02, 0.01]) ** 2  # east, north, yaw
graph = FactorGraph([Between(x[a], x[b], z, Covariance(Sigma))])
result = graph.optimize(Values({x: (SE2, X)}))
said = str(result).splitlines()[-1]
""",
        "",
        ("165 degrees of freedom", "1 expected"),
        """
R_wb = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
graph = FactorGraph([Between(x[a], x[b], z, Covariance(R_wb.T @ Sigma @ R_wb))])
result = graph.optimize(Values({x: (SE2, X)}))
assert 0.8 < result.chi2_final / result.dof < 1.2
""",
        explained=("systematic", "", "frames start certify gnc"),
    ),
    Case(
        "A start that is wound the wrong way",
        """
n = np.arange(8)
ring = Between(x[n], x[(n + 1) % 8], [1.0, 0.0, np.pi / 4], noise)
X = SE2.stack([[0, 0, 0]])
for _ in range(7):
    X = np.vstack([X, SE2.compose(X[-1:], np.array([1.0, 0.0, -np.pi / 4]))])
graph = FactorGraph([ring])
result = graph.optimize(Values({x: (SE2, X)}))  # stays: the gradient is 0
said = nls.certify(graph, result.values).report().splitlines()[0]
""",
        "",
        ("refuted: in the SE-Sync cost another arrangement of the poses fits these measurements better",),
        """
start, *_ = nls.initialize(graph, result.values)
result = graph.optimize(start)
assert nls.certify(graph, result.values).verdict == "certified"
""",
        explained=("local_minimum", "", "start certify"),
    ),
    Case(
        "A kernel that rejects everything",
        """
far = Values({x: (SE2, [[0.0, 0, 0], [5, 5, 1], [9, 1, -1], [3, 9, 2], [1, -7, 0]])})
graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], noise), chain.robust(Tukey(3.0))])
graph.optimize(far)
""",
        "UnderconstrainedError",
        ("factors that do not react to a change here: x1: x, y, yaw", "try another start"),
        """
start, *_ = nls.initialize(graph, far)
result = graph.optimize(start)
""",
        explained=("rejected", "x0 x1 x2 x3 x4", "start wider kernel gentle kernel"),
    ),
)
