r"""The information left for one variable when everything else is estimated too.

With the columns of A split into those of the variable and the rest, A = [A_k A_r], the part of A_k that no change of
the rest can imitate is

    E = A_k - A_r X,   X = argmin |A_k - A_r X|,     M = E'E = A_k'A_k - A_k'A_r (A_r'A_r)^+ A_r'A_k

M is the Schur complement of A'A onto the variable: its inverse is the covariance, the Cramer-Rao bound. E exists where
A_r itself is singular (a free gauge, a free scale, landmarks nothing determines): X is then one of many, E is the same
for all. M n = 0 where the variable can move by n, and the rest by -X n with it, and no measurement changes. Rank is
decided on E, which keeps twice the digits of M.

Source: S. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.7 (the bound with
nuisance parameters).
"""

from itertools import combinations

import numpy as np

from factors.keys import Keys
from models.algebra import Array, Index, Mask
from models.errors import GraphError, OptionError, UnderconstrainedError
from models.options import check_between
from nls.analysis.observable import FREE, Observability
from nls.gauge import choose_gauge, fixed_variables, touched_variables
from nls.graph import FactorGraph
from nls.linear.default import default_solver
from nls.linear.factorization import Factorization, SingularSystemError
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values


def observability(
    graph: FactorGraph, values: Values, key: Keys, length: float | None = None, gauge: str = "first"
) -> Observability:
    """Which components of a variable a data set determines, and how well, all else being estimated.

    Parameters
    ----------
    graph : the measurements, and what is fixed.
    values : where they are linearized: the truth of a simulation, or an estimate.
    key : one variable, such as the mounting of a sensor s[0].
    length : m; a rotation of 1 rad counts as so many meters when directions are compared. The mean distance between the
        variables its factors join when omitted: the mean range of a sonar.
    gauge : ``first``, ``prior`` or ``none``, as in `nls.gauge`. The frame matters for poses and landmarks only.

    Returns
    -------
    Observability
        Print it.

    Raises
    ------
    GraphError
        More than one variable; one that is fixed, or held as the gauge.
    OptionError
        No such gauge; a length that cannot be.
    UnderconstrainedError
        No factor touches the variable.

    Notes
    -----
    It is local, at these values. A direction that is free by geometry alone (all turns about one axis, say) is free at
    the true values. At the estimated ones noise has bent the axis, and the direction is only very weak. So look at the
    sigmas, not only at the rank.

    Examples
    --------
    A hydrophone on a vehicle that passes a pinger at a known place: a range does not know which way it is turned.

    >>> from factors import Isotropic, Range
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l, s = kinds("x", "l", "s")
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [3, 0, 0]]), l: (R(2), [[5, 4]]), s: (SE2, [0.5, 0.2, 0])})
    >>> graph = FactorGraph([Range(x[0:3], l[[0, 0, 0]], [5.9, 5.2, 4.1], Isotropic(0.1), offset=s[0])])
    >>> graph.fix(x[0:3])
    >>> graph.fix(l[0])
    >>> print(observability(graph, values, s[0]))
    s0: 2 of 3 directions determined; fixed by the graph itself
           one sigma  all else known  compared
      x      0.222 m        0.0922 m   1.2 x y
      y      0.178 m        0.0741 m
      yaw       free               -
    free: yaw
    weakest direction, one sigma: x 0.219 m, y -0.172 m
    correlated: x and y, -0.910
    """
    check_one("observability", key)
    if gauge not in ("first", "prior", "none"):
        raise OptionError("gauge", gauge, "one of first, prior, none")
    if length is not None:
        length = check_between("length", length, 0, np.inf, "a distance above 0, m")
    stack = values.stack(key.kind)
    stack.index(key)  # refuses what has no value
    components, units = stack.manifold.components, stack.manifold.units
    pattern, held, description = _held(graph, values, key, gauge)
    system = LinearSystem.at(pattern.holding(held), values)
    A_k, X, E, other_columns = _unexplained(system, _place(pattern, key))
    length = _distance(system.pattern, values, key) if length is None else length
    w = _weights(units, np.linalg.norm(A_k, axis=0), length)
    R = np.linalg.qr(E / w, mode="r")  # (E/w)'(E/w) = R'R
    _, t, Vt = np.linalg.svd(np.pad(R, ((0, max(0, len(w) - len(R))), (0, 0))))
    free = t <= FREE
    N, V, t = _readable(Vt[free]), Vt[~free], t[~free]
    return Observability(
        key=key[0],
        components=components,
        units=units,
        covariance=(V.T / t**2 @ V) / np.outer(w, w),
        undetermined=np.linalg.norm(Vt[free], axis=0) > 1e-6,
        free=N / w,
        with_free=tuple(_with(system, other_columns, X @ (n / w)) for n in N),
        weak=_upright(V / t[:, None] / w, w)[::-1],
        known=np.square(A_k).sum(axis=0),
        weights=w,
        length=length,
        gauge=description,
    )


def check_one(who: str, key: Keys) -> None:
    """Refuse what is not one variable."""
    if not isinstance(key, Keys) or len(key) != 1:
        raise GraphError(f"{who}: expected one variable such as s[0], got {key!r:.60}")


def _held(graph: FactorGraph, values: Values, key: Keys, gauge: str) -> tuple[Pattern, Mask, str]:
    """The pattern, which of its variables (V,) are held, and the sentence of the gauge; refuses a held key."""
    fixed = fixed_variables(graph.fixed, values)
    pattern = graph.pattern(values)
    place = _place(pattern, key)
    if not touched_variables(pattern)[place]:
        message = "no factor touches it, so no measurement determines it; add one that does"
        raise UnderconstrainedError(f"{key}: {message}", [key])
    if fixed[place]:
        raise GraphError(f"observability: {key} is fixed, so there is nothing to determine; release it", [key])
    decided = choose_gauge(gauge, pattern, values, fixed)
    if decided.held[place]:
        message = f"gauge {gauge!r} fixes {key}, so its value is a choice; fix another variable"
        raise GraphError(f"observability: {message}", [key])
    return decided.pattern, decided.held, decided.description


def _place(pattern: Pattern, key: Keys) -> int:
    """Where a variable, which has a value, is in the numbering."""
    return pattern.offsets[key.kind] + int(np.flatnonzero(pattern.numbers[key.kind] == key.numbers[0])[0])


def _distance(pattern: Pattern, values: Values, key: Keys) -> float:
    """Mean distance between the first two places that the factors of a variable join, m; 1 where there are none."""
    place, total, count = _place(pattern, key), 0.0, 0
    for batch in pattern.batches:
        mask = np.any([variables == place for variables in batch.variables], axis=0)
        slots = [k for k, v in enumerate(batch.variables) if not (v == place).any()]
        stacks = {k: values.stacks[batch.kinds[k]] for k in slots}
        P = {k: s.manifold.position(s.X[batch.index[k][mask]]) for k, s in stacks.items()}
        for i, j in list(combinations([k for k in slots if P[k].shape[1]], 2))[:1]:
            if P[i].shape == P[j].shape:
                total, count = total + float(np.linalg.norm(P[i] - P[j], axis=1).sum()), count + int(mask.sum())
    return total / count if total else 1.0


def _weights(units: tuple[str, ...], norms: Array, length: float) -> Array:
    """Weights of a unit of each component (d,): meters, `length` meters a radian, all else by its own column of A_k.

    Scaled so that A_k / w has columns of length 1 in the mean: |E n| for n = w dx of length 1 then is the part of the
    information that is left.
    """
    unit = np.array([{"m": 1.0, "rad": length}.get(name, 0.0) for name in units])
    if (known := unit > 0).any():
        unit[known] *= np.sqrt(np.mean(np.square(norms[known] / unit[known])))
    unit[~known] = norms[~known]
    return np.where(unit > 0, unit, 1.0)


def _readable(N: Array) -> Array:
    """Another basis of the rows of N (k, d), with as many zeros as possible: reduced, the largest pivots first."""
    N = N.copy()
    for k in range(len(N)):
        i, j = divmod(int(np.argmax(np.abs(N[k:]))), N.shape[1])
        N[[k, k + i]] = N[[k + i, k]]
        N[k] /= N[k, j]
        other_rows = np.arange(len(N)) != k
        N[other_rows] -= np.outer(N[other_rows, j], N[k])
    N[np.abs(N) < 1e-6] = 0.0
    order = np.argsort(np.argmax(np.abs(N), axis=1), kind="stable")
    return np.asarray((N / np.linalg.norm(N, axis=1, keepdims=True))[order])


def _upright(V: Array, w: Array) -> Array:
    """Directions (k, d) turned so that their largest component, weighed, is positive."""
    largest = np.argmax(np.abs(V * w), axis=1)[:, None]
    return np.asarray(V * np.sign(np.take_along_axis(V, largest, axis=1)))


def _with(system: LinearSystem, columns: Index, moved: Array) -> str:
    """Companions that move in a free direction, by kinds: "x, y, z of x; x, y, z of l"."""
    pattern = system.pattern
    owner, component = pattern.column_owner()
    kind = np.searchsorted(list(pattern.offsets.values()), owner[columns], side="right") - 1
    size = np.abs(moved) * system.column_norms[columns]
    moves = size >= 0.02 * max(1.0, float(size.max(initial=0.0)))  # beside what the variable would be seen by
    parts = []
    for k, (name, manifold) in enumerate(pattern.manifolds.items()):
        names = [
            c for j, c in enumerate(manifold.components) if (moves & (kind == k) & (component[columns] == j)).any()
        ]
        if names:
            parts.append(f"{', '.join(names)} of {name}")
    return "; ".join(parts)


def _unexplained(system: LinearSystem, variable: int) -> tuple[Array, Array, Array, Index]:
    """A_k (m, d) of a free variable, X (n - d, d), E = A_k - A_r X (m, d), and which columns are the rest (n - d,).

    Parameters
    ----------
    system : a linearization, of any rank.
    variable : its place in the numbering of the pattern.
    """
    pattern = system.pattern
    columns = pattern.starts[variable] + np.arange(pattern.dims[variable])
    other_columns = np.setdiff1d(np.arange(pattern.n), columns)
    A_k, A_r = system.A[:, columns].toarray(), system.A[:, other_columns]
    held = pattern.held.copy()
    held[variable] = True
    factorization = _factorized(LinearSystem(pattern.holding(held), system.blocks, system.b))
    X, E = np.zeros((len(other_columns), len(columns))), A_k
    for _ in range(30):  # a direction of A_r of length 3e-6, columns scaled to 1, halves in each; none was so weak
        step = factorization.solve(np.asarray(A_r.T @ E)) if len(other_columns) else X
        X = X + step
        last, E = E, A_k - A_r @ X
        if np.abs(last - E).max(initial=0.0) <= 1e-13 * np.abs(A_k).max(initial=0.0):
            break
    return A_k, X, E, other_columns


def _factorized(system: LinearSystem) -> Factorization:
    """A_r'A_r factorized as it is; where it is singular with a little damping, taken away again by repeating."""
    analysis = default_solver().analyze(system.pattern)
    try:
        return analysis.factorize(system)
    except SingularSystemError:
        squares = np.square(system.column_norms)
        return analysis.factorize(system, 1e-11 * np.where(squares > 0, squares, 1.0))
