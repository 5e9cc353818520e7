r"""Covariances of the estimate, (A'A)^-1 at the linearization point and parts of it.

    X = X_hat Exp(delta),   delta ~ N(0, Sigma),   Sigma = (A'A)^-1

A few columns of Sigma are solved for with the factor of A'A; the diagonal blocks of all variables come out of one pass
over that factor (`nls.sparse.takahashi`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from factors.base import Factor
from factors.keys import Keys, Kind
from models import LieGroup
from models.algebra import Array, Index
from models.chi_squared import chi2_gate
from models.errors import GraphError, OptionError, UnderconstrainedError
from nls.covariance.frames import Joint, axes, batches_of, joint_of, of_motions, turned
from nls.covariance.gate import Gate, predicted_distances
from nls.covariance.inverse import (
    ONE_BLOCK,
    FreePart,
    SelectedInverse,
    Undetermined,
    anchored_factorization,
    dense_inverse,
    free_part,
    of_unmeasured,
    paired,
    used_components,
)
from nls.gauge import choose_gauge, fixed_variables, placeless_kinds
from nls.linear import LinearSolver, default_solver
from nls.linear.default import factorized_by
from nls.linear.factorization import SingularSystemError
from nls.linear.limits import checked_limit
from nls.sparse.pattern import Pattern, measuring
from nls.system import LinearSystem
from nls.values import Values, refuse_other

if TYPE_CHECKING:
    from nls.graph import FactorGraph


class Marginals:
    """Covariances at the optimum: ``Marginals(graph, result.values)``.

    Parameters
    ----------
    graph : the factors. Directions that stay free once the gauge is held have no covariance; all else has.
    values : where it is linearized. Factors with a robust kernel count with their weight there, as in the last step of
        the optimizer. A rejected outlier adds no information.
    linear_solver : its factorization of A'A is used; of `QR` the factor R of A, with directions that A'A loses. A
        solver without (the dense ones) and none at all mean the best one installed. A `block_inverse` is refused.
    gauge : as in `FactorGraph.optimize`. Held variables have covariance zero, and all others are relative to them;
        `gauge` below is the sentence that says which. ``free``: the pseudo-inverse, where nobody is held.
    memory_limit : bytes; what would take more is refused beforehand. Half of the memory when omitted.
    pairs : (i, j) batches of variables that share no factor and are asked for by `cross` or `relative` all the same.

    Attributes
    ----------
    values : a copy of the linearization point.
    gauge : the gauge that holds the graph, in words.
    placeless : kinds of variables that have no place on a map, such as the drift of a speed.

    Raises
    ------
    UnderconstrainedError
        The measurements leave every variable free: named, with cures.
    OptionError
        A linear solver that does not factorize A'A itself; a memory limit that is none.

    Notes
    -----
    Poses have a covariance along the axes of the body and one along those of the world, so `frame` must be given:

    - ``body``: of the tangent step, delta = (rho, phi) in X Exp(delta). What a factor on this pose would take as noise.
    - ``world``: of (R rho, R phi), in the plane (R rho, phi): the errors of position and rotation along the axes of the
      world. Not Ad_X Sigma Ad_X'. Its translation part is the error of the point of the *body* at the origin of the
      world, and grows with the distance from there.

    Vectors, and rotations of the plane, have one frame only and need none. See the theory page on covariances.

    With N a basis of the free directions, A N = 0, the covariance of y = J delta exists when J N = 0. So a variable
    whose rows of N are zero keeps its covariance, whatever else is free. A pose of which only the heading is free keeps
    the covariance of its position, ``view="position"``. All else is refused by name. Of directions that move several
    variables 96 are looked for; where more are free the graph is refused as a whole.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls import Marginals, kinds
    >>> x, l = kinds("x", "l")
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> marginals = Marginals(world.graph, world.truth)
    >>> marginals.gauge
    'x0 fixed'
    >>> marginals.covariance(x[10], frame="world").shape, marginals.covariance(x[10], view="position").shape
    ((3, 3), (2, 2))
    >>> marginals.all(x, frame="body").shape
    (40, 3, 3)

    One range leaves a landmark free; the poses are determined all the same:

    >>> from factors import Isotropic, Range
    >>> from models import R
    >>> from nls import FactorGraph, Values
    >>> graph = world.graph + FactorGraph([Range(x[3], l[0], [5.0], Isotropic(0.1))])
    >>> marginals = Marginals(graph, world.truth | Values({l: (R(2), [[9.0, 9.0]])}))
    >>> marginals.status(l), marginals.covariance(x[10], frame="world").shape, marginals.underconstrained.components
    (['free'], (3, 3), ('l0: x, y',))
    """

    def __init__(
        self,
        graph: FactorGraph,
        values: Values,
        linear_solver: LinearSolver | None = None,
        gauge: str = "first",
        memory_limit: float | None = None,
        pairs: Sequence[tuple[Keys, Keys]] = (),
    ) -> None:
        refuse_other("Marginals", graph, values)
        if not len(graph):
            raise GraphError("the graph has no factors: nothing has a covariance")
        if not isinstance(linear_solver, LinearSolver | None):
            raise OptionError("linear_solver", linear_solver, "a linear solver such as nls.LU()")
        if linear_solver is not None and not linear_solver.exact:
            allowed = "a solver that factorizes A'A itself, such as nls.Schur() without block_inverse"
            raise OptionError("linear_solver", linear_solver, f"{allowed}; no other has its inverse")
        self.values, self.memory_limit = values.copy(), checked_limit(memory_limit)
        fixed, pattern = fixed_variables(graph.fixed, values), graph.pattern(values)
        if pairs:
            pattern = Pattern([*graph.factors, *paired(pairs)], values)
        decided = choose_gauge(gauge, pattern, values, fixed)
        pattern = decided.pattern.holding(decided.held)
        system = LinearSystem.at(pattern, values)
        self._undetermined: Undetermined | None = None
        try:
            self._factorization = factorized_by(linear_solver, default_solver(pattern.n), system)
        except SingularSystemError:
            pattern, self._factorization, self._undetermined = anchored_factorization(pattern, values, linear_solver)
        self._pattern, self.placeless, self.gauge = pattern, placeless_kinds(pattern), decided.description
        self._free: FreePart | None = None
        if decided.free:
            unheld = decided.pattern.holding(decided.fixed)
            others = None if self._undetermined is None else self._undetermined.N
            self._free = free_part(pattern, unheld, self._factorization, values, self.memory_limit, others)
        moved = np.zeros(len(fixed), dtype=bool)
        if self._undetermined is not None:
            moved[pattern.column_owner()[0][self._undetermined.moved]] = True
        words = ["fixed", "unmeasured", "gauge", "free"]  # the first that holds
        self._status = np.select([fixed, decided.fixed, decided.held & (not decided.free), moved], words, "estimated")
        self._first = np.cumsum(pattern.dims) - pattern.dims  # column of every variable, held or not
        self._column = np.full(int(pattern.dims.sum()), -1)  # column of A of each of these
        self._column[pattern.expand(np.ones(pattern.n)) > 0] = np.arange(pattern.n)

    @property
    def underconstrained(self) -> UnderconstrainedError | None:
        """The error that names all that the measurements leave free; None where every variable is determined."""
        return None if self._undetermined is None else self._undetermined.error

    def covariance(self, keys: Keys, frame: str | None = None, view: str | None = None) -> Array:
        """Covariance (d, d) of one variable, or (n, d, d) of each of several.

        Parameters
        ----------
        keys : ``x[3]`` or ``x[[1, 2, 3]]``.
        frame : ``body`` or ``world``, required for poses and rotations in space.
        view : ``position``, (2, 2) or (3, 3) along the axes of the world; ``euler``, (6, 6) of roll, pitch, yaw, x,
            y and z of a pose in space, rad and m; both need no frame.

        Returns
        -------
        array, symmetric, m and rad as the components of the variable.

        Raises
        ------
        OptionError
            A pose without a frame; a view the variable does not have.
        UnderconstrainedError
            A variable no measurement touches, or that the measurements leave free: it has no covariance.
        SingularGeometryError
            Euler angles at gimbal lock.
        """
        J, _ = self._axes(keys, frame, view)
        columns = self._columns(keys)  # (n, d)
        n, d = columns.shape
        if n * d <= ONE_BLOCK:
            Sigma = self._dense(columns.reshape(-1)).reshape(n, d, n, d)[np.arange(n), :, np.arange(n), :]
        else:
            Sigma = self._diagonal[keys.kind][self.values.stack(keys.kind).index(keys)]
        Sigma = turned(J, Sigma)
        return Sigma[0] if keys.single else Sigma

    def all(self, kind: Kind, frame: str | None = None, view: str | None = None) -> Array:
        """Covariances (n, d, d) of all variables of a kind, in the order of the values; one pass for all kinds.

        Parameters
        ----------
        kind : ``x``.
        frame, view : as in `covariance`.

        Raises
        ------
        UnderconstrainedError
            One of them has no covariance, see `status`.
        """
        if not isinstance(kind, Kind):
            raise GraphError(f"Marginals.all: expected a kind such as x, got {kind!r:.60}; covariance takes variables")
        keys = Keys(kind.name, self.values.stack(kind.name).numbers)
        J, _ = self._axes(keys, frame, view)
        return turned(J, self._diagonal[kind.name].copy())

    def cross(self, i: Keys, j: Keys, frame: str | None = None, view: str | None = None) -> Array:
        """Cross-covariance (n, d_i, d_j) of pairs of variables that share a factor or are `pairs`; one pass for all.

        Parameters
        ----------
        i, j : the pairs, as many of one as of the other.
        frame, view : as in `covariance`.

        Raises
        ------
        GraphError
            Not as many of one as of the other; a pair that shares no factor.
        UnderconstrainedError
            One of them has no covariance, see `status`.
        """
        (J_i, _), (J_j, _) = self._axes(i, frame, view), self._axes(j, frame, view)
        if len(i) != len(j):
            raise GraphError(f"Marginals.cross: {len(i)} and {len(j)} variables; expected pairs", [i, j])
        u, v = self._variables(i), self._variables(j)
        if (apart := self._selected.lacks(u, v)).any():
            k = int(np.argmax(apart))
            text = f"{i[[k]]!r} and {j[[k]]!r} share no factor; ask for joint(...), or Marginals(..., pairs=[(i, j)])"
            raise GraphError(f"Marginals.cross: {text}", [i[[k]], j[[k]]])
        Sigma = self._blocks(i, j) if J_i is None else J_i @ self._blocks(i, j)
        return Sigma if J_j is None else Sigma @ J_j.mT

    def relative(self, i: Keys, j: Keys) -> Array:
        """Covariance (n, d, d) of motions X_i^-1 X_j of pairs of poses that share a factor, see `cross`.

        .. math:: G = X_i^{-1} X_j\\,\\operatorname{Exp}(\\delta),  \\quad \\delta = \\delta_j - Ad(G)^{-1} \\delta_i

        Parameters
        ----------
        i, j : the pairs, as many of one as of the other; in the axes of j.

        Raises
        ------
        GraphError, UnderconstrainedError
            As `cross`; variables that are no poses.
        """
        group = self.values.stack(i.kind).manifold
        if not isinstance(group, LieGroup) or self.values.stack(j.kind).manifold is not group:
            raise GraphError(f"Marginals.relative: {i[[0]]!r} and {j[[0]]!r} are no poses of one group", [i, j])
        C_ii, C_jj = (self.covariance(keys, frame="body") for keys in (i, j))
        G = group.between(self.values[i], self.values[j])
        return of_motions(group, G, C_ii, self.cross(i, j, frame="body"), C_jj)

    def joint(self, *keys: Keys | Sequence[Keys], frame: str | None = None, view: str | None = None) -> Joint:
        """Joint covariance of any set of variables, of one kind or several, with names on its rows.

        Parameters
        ----------
        *keys : ``x[1], l[0]``, also batches ``x[[1, 2, 3]]`` and lists of them.
        frame, view : as in `covariance`, of each variable by itself: where ``body`` is asked for, a pose has the axes
            of its own body, and a point beside it those of the world, which it always has.

        Raises
        ------
        ResourceLimitError
            The dense matrix would need more than the memory limit.
        GraphError
            No variable is given, or one twice.
        UnderconstrainedError
            One of them has no covariance, see `status`.
        """
        batches = batches_of(keys)
        shown = [self._axes(batch, frame, view) for batch in batches]
        columns = [self._columns(batch) for batch in batches]
        return joint_of(batches, shown, columns, self._dense(np.concatenate([c.reshape(-1) for c in columns])))

    def gate(self, factor: Factor, probability: float = 0.99) -> Gate:
        r"""How far measurements that the graph has not used are from its prediction, and how far right ones may be.

        .. math:: d^2 = \nu^T S^{-1} \nu, \quad \nu = z \boxminus h(\hat X), \quad S = H \Sigma H^T + R

        Parameters
        ----------
        factor : n measurements of variables that have values here; a robust kernel makes no difference.
        probability : with which the distance of a right measurement is below the limit.

        Returns
        -------
        d2, limit : squared Mahalanobis distances (n,), and the quantile of chi-squared.

        Raises
        ------
        GraphError
            A factor of the graph, whose estimate has used the measurements; one that measures nothing, as limits do, or
            different counts of numbers, as with zeros in some of its information matrices.
        UnderconstrainedError
            One of the variables has no covariance, see `status`.

        Examples
        --------
        >>> import numpy as np
        >>> import sim
        >>> from factors import Isotropic, Position
        >>> from nls import Marginals, kinds
        >>> (x,) = kinds("x")
        >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
        >>> place = world.truth[x[15]][:2]
        >>> fixes = Position(x[[15, 15]], [place, place + 3.0], Isotropic(0.1))  # the second is 4 m off
        >>> d2, limit = Marginals(world.graph, world.truth).gate(fixes)
        >>> d2 < limit
        array([ True, False])
        """
        if not isinstance(factor, Factor):
            raise GraphError(f"Marginals.gate: expected a factor such as Between(...), got {factor!r:.80}")
        if any(batch.model.factor is factor for batch in self._pattern.batches):
            cure = "take it out of the graph and optimize, then ask"
            raise GraphError(f"Marginals.gate: {factor!r:.80} is in the graph, and the estimate has used it; {cure}")
        d2, model = self.distances(factor), self.values.gather(factor)[0]
        m = sorted({*measuring(model).tolist()}) or [model.dim]
        if len(m) > 1 or not m[0]:
            cure = "a limit is for one such count, 1 or more: ask for factor[rows] of one"
            raise GraphError(f"Marginals.gate: {factor!r:.80} measures {' or '.join(map(str, m))} numbers; {cure}")
        return Gate(d2, chi2_gate(m[0], probability))

    def distances(self, factor: Factor) -> Array:
        """The d2 (n,) of `gate`, also where it has no limit."""
        for keys in factor.keys:
            self._axes(keys, "body", None)
        model, X = self.values.gather(factor)
        columns = np.concatenate([self._columns(keys) for keys in factor.keys], axis=1)
        return predicted_distances(*model.linearize(*X), columns, self._dense)

    def status(self, kind: Kind | str) -> list[str]:
        """The status of every variable of a kind, in the order of the values.

        ``estimated``; ``gauge`` or ``fixed``: held, its covariance is zero; ``unmeasured``: no measurement touches it,
        ``free``: the measurements leave it free in some direction. These two have no covariance.
        """
        stack = self.values.stack(kind)
        return [str(word) for word in self._status[self._pattern.offsets[stack.kind] :][: len(stack)]]

    @cached_property
    def _selected(self) -> SelectedInverse:
        return SelectedInverse(self._factorization, self.memory_limit, self._pattern.held)

    @cached_property
    def _diagonal(self) -> dict[str, Array]:
        """Diagonal blocks (n, d, d) of every kind, axes of the tangent space."""
        keys = {kind: Keys(kind, stack.numbers) for kind, stack in self.values.stacks.items() if len(stack)}
        blocks = {kind: self._blocks(these, these) for kind, these in keys.items()}
        return {kind: (Sigma + Sigma.mT) / 2 for kind, Sigma in blocks.items()}

    def _blocks(self, i: Keys, j: Keys) -> Array:
        """Blocks (n, d_i, d_j) of pairs that share a block of H, axes of the tangent spaces."""
        rows, columns = self._columns(i), self._columns(j)
        Sigma = self._selected.blocks(self._variables(i), self._variables(j), rows.shape[1], columns.shape[1])
        return Sigma if self._free is None else self._free.moved(Sigma, rows, columns)

    def _dense(self, columns: Index) -> Array:
        """Rows and columns (k,) of Sigma, axes of the tangent spaces."""
        Sigma = dense_inverse(self._factorization, self._column[columns], self.memory_limit)
        if self._free is not None:
            Sigma = self._free.moved(Sigma, columns, columns)
        return (Sigma + Sigma.T) / 2

    def _variables(self, keys: Keys) -> Index:
        """Place (n,) of variables among all."""
        return np.asarray(self._pattern.offsets[keys.kind] + self.values.stack(keys.kind).index(keys))

    def _columns(self, keys: Keys) -> Index:
        """Columns (n, d) of variables among those of all variables."""
        dim = self.values.stack(keys.kind).manifold.dim
        return np.asarray(self._first[self._variables(keys)][:, None] + np.arange(dim))

    def _axes(self, keys: Keys, frame: str | None, view: str | None) -> tuple[Array | None, tuple[str, ...]]:
        """As `nls.covariance.frames.axes`; refuses what is not determined."""
        if not isinstance(keys, Keys):
            raise GraphError(f"Marginals: {keys!r:.60} names no variable; expected x[0], x[[1, 2]], or all(x) for all")
        stack = self.values.stack(keys.kind)
        if (unmeasured := self._status[self._variables(keys)] == "unmeasured").any():
            raise of_unmeasured(list(keys[unmeasured]))
        J, names = axes(keys, stack.manifold, np.asarray(stack.X[stack.index(keys)]), frame, view)
        if self._undetermined is not None:
            columns = self._column[self._columns(keys)]
            self._undetermined.refuse(keys, columns, used_components(J, columns.shape), stack.manifold.components)
        return J, names
