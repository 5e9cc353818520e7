r"""Exact marginalization: variables leave a graph, and their measurements become one prior on their neighbors.

The factors that touch the variables e that leave, linearized, are rows A_e d_e + A_r d_r = b over them and over the
variables r they are joined to. With [A_e A_r b] = Q R::

    R = | R_ee  R_er  c_e |          min over d_e of |A d - b|^2  =  |R_rr d_r - c_r|^2 + constant
        |       R_rr  c_r |

so R_rr, c_r are the whitened prior on r. On a linear problem nothing is lost. Otherwise the prior is the best Gaussian
at the point where the variables left, and stays so, while later measurements of r are linearized anew. The two must
agree on what is unobservable, else the window measures its own heading (A. Mourikis, J. Dong-Si, "Motion tracking with
fixed-lag smoothing", ICRA 2011). So the prior is Gaussian in coordinates that a common motion G of everything leaves
alone: one pose S of r sees all others, (G S)^-1 (G X) = S^-1 X. Where the rows say nothing of a motion of S, neither
does the prior, wherever r has moved to.

Sources: F. Dellaert, M. Kaess, Factor Graphs for Robot Perception, 2017, section 5.3, for the prior; J. Castellanos, R.
Martinez-Cantin, J. Tardos, J. Neira, "Robocentric map joining", Robotics and Autonomous Systems 55, 2007, for the
coordinates.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic
from models import LieGroup, Manifold, R
from models.algebra import Array, Mask
from models.errors import UnderconstrainedError
from models.sensors import seen_from
from nls.incremental.growing_system import GrowingSystem
from nls.sparse.elimination import connected
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

# of variables of one space: the group of the pose that sees them, if any, its slot, theirs, Y0 (k, size), A T (k, m, d)
_Chart = tuple[Manifold | None, int, list[int], Array, Array]


class MarginalPrior(Factor):
    r"""The rest of measurements of variables that are gone: a Gaussian over several others, correlated.

    .. math:: h(S, X_2, \dots, X_k) = A \, T \, (c_1, \dots, c_k), \quad
              c_1 = \mathrm{motion}(S^0, S), \quad
              c_j = \mathrm{motion}(S^{0\,-1} X_j^0, \; S^{-1} X_j)

    S is the first pose. T makes A T c equal to A delta for small steps delta from X0. Where there is no pose, and of
    variables that a common motion does not move, c_j = motion(X_j^0, X_j).

    Parameters
    ----------
    keys : the variables, one each.
    X0 : per variable the value (size,) where it was linearized.
    A : (m, D) whitened rows over the tangent steps delta from X0, side by side.
    z : (m,) whitened right-hand side.
    relative, unmoved, axes : as the measurements were, see `Factor`; axes is what `knows_axes` says.

    Notes
    -----
    A motion of everything changes c_1 alone, and relative measurements say nothing of c_1. Depths and tilts say
    something of depth and tilt, which c_1 of SE3 keeps apart (`SE3.motion`). A prior over points alone has no such
    coordinates.

    Points step along straight lines. Where everything turns by an angle that is hardly known, Gauss-Newton may go back
    and forth. The library then takes Levenberg-Marquardt, as for every factor that is `damped`.

    Examples
    --------
    >>> import numpy as np
    >>> from models import R
    >>> from nls import FactorGraph, Values, kinds
    >>> (p,) = kinds("p")
    >>> prior = MarginalPrior([p[1], p[2]], [np.zeros(1), np.ones(1)], np.array([[2.0, 0.0], [1.0, 1.0]]), np.ones(2))
    >>> graph = FactorGraph([prior])
    >>> graph.optimize(Values({p: (R(1), [[0.0], [0.0]], [1, 2])})).values[p].ravel().round(6)
    array([0.5, 1.5])
    """

    damped = True
    cached = ("_charts",)  # follows from the other attributes

    def __init__(
        self,
        keys: Sequence[Keys],
        X0: Sequence[Array],
        A: Array,
        z: Array,
        relative: bool = False,
        unmoved: tuple[int, ...] = (),
        axes: bool = False,
    ) -> None:
        super().__init__(keys, z, Isotropic(1.0))
        A, X0 = np.asarray(A, dtype=float), tuple(np.asarray(x0, dtype=float) for x0 in X0)
        if A.ndim != 2 or len(X0) != len(keys) or not set(unmoved) <= set(range(len(keys))):
            raise self._refusal(f"expected A (m, D), and a value in X0 for each of {len(keys)} variables")
        self.slots, self.X0, self.A, self.unmoved = (None,) * len(keys), X0, A, unmoved
        self.relative, self.axes = bool(relative), bool(axes)
        self._charts: dict[tuple[Manifold, ...], list[_Chart]] = {}  # by spaces; copies of the prior share it

    def knows_axes(self, manifolds: tuple[Manifold | None, ...]) -> bool:
        return self.axes

    def sizes(self) -> tuple[int, ...]:
        return (len(self.A),)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        D, sizes = sum(manifold.dim for manifold in manifolds), [x0.shape for x0 in self.X0]
        if self.A.shape[1] != D or sizes != [(manifold.size,) for manifold in manifolds]:
            raise self._refusal(f"A has shape {self.A.shape}, X0 has {sizes}; they do not fit {manifolds}")
        return R(len(self.A))

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        h: Array = np.zeros((len(X[0]), len(self.A)))
        H: list[Array] = [np.zeros((len(h), len(self.A), space.dim)) for space in manifolds]
        for group, root, slots, Y0, rows in self._charted(manifolds):
            space, x = manifolds[slots[0]], np.stack([X[k] for k in slots], axis=1)
            Y, (H_S, H_X) = _view(group, X[root][:, None], space, x)
            c, J = space.motion(Y0, Y)
            h += np.einsum("kmd,nkd->nm", rows, c)
            moves = rows @ J
            for k, H_k in zip(slots, np.moveaxis(moves @ H_X, 1, 0), strict=True):
                H[k] += H_k
            H[root] += (moves @ H_S).sum(axis=1)
        return h, tuple(H)

    def _charted(self, manifolds: tuple[Manifold, ...]) -> list[_Chart]:
        """A T, with the pose that sees the others last; it depends on X0 alone, and is kept."""
        if manifolds in self._charts:
            return self._charts[manifolds]
        A = np.split(self.A, np.cumsum([manifold.dim for manifold in manifolds])[:-1], axis=1)
        poses = (k for k, space in enumerate(manifolds) if isinstance(space, LieGroup) and not space.flat)
        first = next((k for k in poses if k not in self.unmoved), None)
        sorts: dict[tuple[Manifold, bool, bool], list[int]] = {}
        for k in sorted(range(len(A)), key=lambda k: k == first):
            sorts.setdefault((manifolds[k], k in self.unmoved, k == first), []).append(k)
        charts: list[_Chart] = []
        for (space, *alone), slots in sorts.items():
            group, root = (None, slots[0]) if first is None or any(alone) else (manifolds[first], first)
            Y0, (H_S, H_X) = _view(group, self.X0[root], space, np.stack([self.X0[k] for k in slots]))
            J = space.motion(Y0, Y0)[1]
            rows = np.stack([A[k] for k in slots]) @ np.linalg.inv(J @ H_X)
            A[root] = A[root] - (rows @ J @ H_S).sum(axis=0)
            charts.append((group, root, slots, Y0, rows))
        self._charts[manifolds] = charts
        return charts


def _view(group: Manifold | None, S: Array, space: Manifold, X: Array) -> tuple[Array, tuple[Array, Array]]:
    """As `seen_from`; X itself without a pose, and where motions of the group do not move the space."""
    if isinstance(group, LieGroup) and (view := seen_from(group, S, space, X)) is not None:
        return view
    return X, (np.zeros((space.dim, 1)), np.eye(space.dim))  # one 0 for all numbers of a pose


def marginalized(factors: Sequence[Factor], values: Values, leaving: Sequence[Keys]) -> tuple[list[Factor], Values]:
    """Factors and values without some variables; the information about the rest is kept.

    Parameters
    ----------
    factors : of a graph; of each batch the measurements that touch what leaves are used up.
    values : every variable, where the factors are linearized.
    leaving : the variables that go.

    Returns
    -------
    factors, values : the measurements left over and, last, a `MarginalPrior` for each connected part that something
        leaves; the variables left over.

    Raises
    ------
    UnderconstrainedError
        The measurements do not determine what leaves; named.

    Examples
    --------
    >>> from factors import Between, Isotropic, Prior
    >>> from models import R
    >>> from nls import FactorGraph, Values, kinds
    >>> (p,) = kinds("p")
    >>> factors = [Prior(p[0], 1.0, Isotropic(3.0)), Between(p[0], p[1], 2.0, Isotropic(4.0))]
    >>> left, values = marginalized(factors, Values({p: (R(1), [[0.0], [0.0]])}), [p[0]])
    >>> left, FactorGraph(left).optimize(values).values[p].ravel().round(6), abs(left[0].A).round(6)
    ([MarginalPrior(p1)], array([3.]), array([[0.2]]))
    """
    system = GrowingSystem()
    for key in values:
        system.join(key, values.stack(key.kind).manifold, values[key])
    for factor in factors:
        system.enter(factor, factor)
    system.catch_up()
    marginalize(system, {k.kind: np.isin(system.variables[k.kind].numbers, k.numbers) for k in leaving})
    return [factor for _, factor in system.given], system.values


def marginalize(system: GrowingSystem, gone: dict[str, Mask]) -> None:
    """Take out variables (n,) by kind, and the measurements of them; what these say of the others enters as priors.

    Raises
    ------
    UnderconstrainedError
        The measurements do not determine what leaves; named, and all is as before.
    """
    rows, values = [batch.touches(gone) for batch in system.batches], system.values
    touching = [(batch, some) for batch, some in zip(system.batches, rows, strict=True) if some.any()]
    pattern = Pattern([batch.model(some).factor for batch, some in touching], values)
    blocks = [batch.blocks(some) for batch, some in touching]
    b = np.concatenate([batch.b.reshape(len(batch), -1)[some].ravel() for batch, some in touching])
    # rows of robust measurements are bent for steps, see `nls.incremental.growing_arrays`; a prior is a Gaussian
    linear = LinearSystem.at(pattern, values) if system.robust else LinearSystem(pattern, blocks, b)
    goes = [gone.get(kind, np.zeros(len(v), dtype=bool)) for kind, v in system.variables.items()]
    system.exchange(rows, gone, [*_priors(linear, np.concatenate(goes), values)])


def _priors(linear: LinearSystem, goes: Mask, values: Values) -> Iterator[MarginalPrior]:
    """The information of measurements about the other variables, of each connected part; none where it is nothing."""
    pattern, whole = linear.pattern, np.column_stack([linear.A.toarray(), linear.b])
    owner, models = pattern.column_owner()[0], [batch.model for batch in pattern.batches]
    unmoved = {model.factor.keys[slot].kind for model in models for slot in model.factor.unmoved}
    moves = np.repeat([kind not in unmoved for kind in pattern.numbers], [*map(len, pattern.numbers.values())])
    row, column = np.nonzero(whole[:, :-1])
    joins = (moves | goes)[owner[column]]  # what stays and no motion moves joins no two parts
    label = connected(owner[column[joins]], len(goes) + row[joins], len(goes) + pattern.m)
    of_variable, of_row = np.split(label, [len(goes)])
    for part in np.unique(of_variable[goes]).tolist():
        leaves, rows = goes & (of_variable == part), of_row == part
        stays = ~goes & np.isin(np.arange(len(goes)), owner[whole[rows, :-1].any(axis=0)])
        columns = np.concatenate([np.flatnonzero(leaves[owner]), np.flatnonzero(stays[owner])])
        e, dense = int(pattern.dims[leaves].sum()), whole[rows][:, [*columns, -1]]
        free, near = ([pattern.key(k) for k in np.flatnonzero(mask).tolist()] for mask in (leaves, stays))
        triangle: Array = np.asarray(np.linalg.qr(dense, mode="r"))
        pivots, lengths = np.abs(np.diagonal(triangle[:, :e])), np.sqrt(np.square(dense[:, :e]).sum(axis=0))
        if len(pivots) < e or (pivots <= 1e-12 * lengths).any():  # rounding of 0
            cause = "the measurements so far do not determine all of it"
            cure = "Keep it longer (a larger lag), or add what is known of it as a Prior"
            raise UnderconstrainedError(f"{', '.join(map(repr, free))} cannot leave the window: {cause}. {cure}", free)
        left = triangle[e : len(columns)]  # below is the constant alone
        if near and len(left):
            slots = tuple(k for k, key in enumerate(near) if key.kind in unmoved)
            of_part = [batch.model for batch in pattern.batches if rows[batch.rows].any()]
            relative = all(model.factor.relative for model in of_part)
            axes = any(model.factor.knows_axes(model.manifolds) for model in of_part)
            yield MarginalPrior(near, [values[key] for key in near], left[:, e:-1], left[:, -1], relative, slots, axes)
