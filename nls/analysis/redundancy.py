r"""Groups of loop closures that carry the map and that nothing verifies: their redundancy and external reliability.

Closures whose ends are near one another at both sides say the same, and share their errors. One place taken for another
makes all of them wrong by one motion. The model error of a group is a vector nabla of d numbers,

    b = A dx + C nabla + e,    e ~ N(0, I),    C = A_j Ad(T_j^-1 T_r) in the rows of the group, 0 elsewhere.

A_j are the whitened Jacobians of the later ends T_j. A common error is one rigid motion of all later ends, written at
one pose T_r among them. With P = (A'A)^-1 the residuals of the optimum are (I - A P A') b. They determine nabla with
the information M; a known map would with N,

    N = C'C,    M = C'(I - A P A') C = N - U'P U,    U = A'C,

and without whitening N = B'R^-1 B, M = N - B'R^-1 S R^-1 B: R is the covariance of the group's noise, S that of its
predicted measurements, B their derivative by nabla. The estimate n = M^-1 C'(I - A P A') b has the statistic

    t = n'M n ~ chi2(d, lambda),    lambda = nabla'M nabla.

For a level and a power of the test Baarda takes the noncentrality lambda_0 that is needed; the minimal detectable bias
is the nabla with nabla'M nabla = lambda_0. The share of a common error that the residuals show is the redundancy of
the group as one,

    r = tr(N^-1 M) / d = 1 - tr(N^-1 U'P U) / d,    0 <= r <= 1.

That of the stack of k closures, tr(I - R^-1 S) / (k d), is about (k - 1) / k however wrong they are: they check each
other. Near r = 0 the map follows the group, whatever it says. If the group is freed as one the map moves by

    dx = -P U n,

and without the group by as much, but for what its closures say about each other. That step ranks the groups. Those it
moves far are left out and the graph is solved again; the numbers of the result are from there.

Source: W. Baarda, "A testing procedure for use in geodetic networks", 1968, internal and external reliability;
P. Teunissen, "Testing theory: an introduction", 2000, model errors of several dimensions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse as sp

from factors.keys import Kind
from models import LieGroup
from models.algebra import Array, Index
from models.chi_squared import mahalanobis
from models.errors import UnderconstrainedError
from nls.analysis.leave_one_out import UNSEEN_REDUNDANCY
from nls.covariance import Marginals
from nls.gauge import choose_gauge, component_labels, fixed_variables, touched_variables
from nls.graph import FactorGraph
from nls.linear import factorize
from nls.linear.factorization import Factorization, SingularSystemError
from nls.linear.underconstrained import underconstrained
from nls.metrics import displacements
from nls.posegraph import closures, odometry, places
from nls.sparse.elimination import connected
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.starts.chordal import chordal
from nls.system import LinearSystem
from nls.values import Values

GROUP_WINDOW = 20  # steps at either end between closures of one group
MOVED_SIGMAS = 3.0  # of a pose; those groups 3.1 to 50, right groups that move a public graph by PART up to 1.5
PART = 0.005  # of the extent of the map: rms motion, as for contradicted groups; those wrong groups 0.9 to 26 %


@dataclass(frozen=True)
class ClosureGroup:
    """Neighboring closures of one batch of measurements or of several.

    Attributes
    ----------
    batch, index : (k,) number of the batch, of the measurement in it.
    late : (k,) slot of the later pose.
    kinds : kinds of the poses.
    """

    batch: Index
    index: Index
    late: Index
    kinds: tuple[str, ...]

    def places(self, values: Values) -> Array:
        """(n, k) positions of all poses of the kinds, m."""
        stacks = [values.stacks[kind] for kind in self.kinds]
        return np.concatenate([stack.manifold.position(stack.X) for stack in stacks])


def closure_groups(pattern: Pattern) -> Iterator[ClosureGroup]:
    """Closures between trajectories, in groups of those within 20 steps of each other at both ends.

    Only kinds with steps from pose to pose are trajectories; rotations alone have no place on a map and no group.
    """
    from scipy.spatial import cKDTree

    masks = zip(pattern.batches, odometry(pattern), strict=True)
    tracks = {batch.kinds[0] for batch, steps in masks if steps.any()}
    sizes = [len(numbers) for numbers in pattern.numbers.values()]
    place = places(pattern) + np.repeat((GROUP_WINDOW + 1) * np.arange(len(sizes)), sizes)  # none reaches the next kind
    tables = []
    for number, (batch, closing) in enumerate(zip(pattern.batches, closures(pattern), strict=True)):
        index = np.flatnonzero(closing)
        manifold = pattern.manifolds[batch.kinds[0]]
        if len(index) and {*batch.kinds[:2]} <= tracks and manifold.position(manifold.identity()).shape[-1]:
            ends = np.stack([place[batch.variables[slot][index]] for slot in (0, 1)], axis=1)
            late = ends.argmax(axis=1)
            tables.append(np.column_stack([np.full(len(index), number), index, late, np.sort(ends, axis=1)]))
    if not tables:
        return
    table = np.concatenate(tables)
    a, b = cKDTree(table[:, 3:].astype(float)).query_pairs(GROUP_WINDOW, p=np.inf, output_type="ndarray").T
    label = connected(a, b, len(table))
    order = np.argsort(label, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        numbers, indices, slots = table[members, :3].T
        kinds = tuple(sorted({*pattern.batches[numbers[0]].kinds[:2]}))
        yield ClosureGroup(numbers, indices, slots, kinds)


@dataclass(frozen=True)
class Unverified:
    """A group of closures that carries the map and that the other measurements do not verify.

    Attributes
    ----------
    closures : pairs (factor, measurement), the number of the factor in its graph and of the measurement in the factor.
    names : of the closures.
    redundancy : share of a common error of the group that the residuals show, 0 to 1.
    meters, rms : largest and root mean square motion of the poses without the group, m; both maps aligned rigidly.
    sigmas : largest motion of a pose without the group, in the sigmas of its position there; the gauge held.

    Where the graph falls apart without the group, or something is free, meters, rms and sigmas are infinite.
    """

    closures: tuple[tuple[int, int], ...]
    names: tuple[str, ...]
    redundancy: float
    meters: float
    rms: float
    sigmas: float


@single_thread()
def unverified_groups(graph: FactorGraph, values: Values) -> tuple[Unverified, ...]:
    """Groups of closures of low redundancy without which the map moves, the largest motion first.

    Parameters
    ----------
    graph : relative poses along trajectories, in kinds with steps from pose to pose, and closures between these. Other
        factors take part and are not tested; neither are poses without a position (rotations alone).
    values : its optimum.

    Returns
    -------
    groups with a redundancy below 0.1, without which a pose moves by 3 sigmas and the map by 0.5 % of its extent (rms).

    Raises
    ------
    UnderconstrainedError
        The measurements leave something free.

    Examples
    --------
    Two laps of 60 poses along odometry. Ten closures that agree say that the second lap begins ten steps early:

    >>> import numpy as np
    >>> import nls, sim
    >>> from factors import Between, Diagonal
    >>> from nls.analysis import unverified_groups
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=60)
    >>> x, = nls.kinds("x")
    >>> k = np.arange(10)
    >>> wrong = Between(x[k], x[k + 50], np.zeros((10, 3)), Diagonal(x=0.05, y=0.05, yaw=0.01))
    >>> graph = nls.FactorGraph([world.graph.factors[0], wrong])
    >>> (group,) = unverified_groups(graph, graph.optimize(world.start).values)
    >>> group.names[0], len(group.closures), round(group.redundancy, 2), group.meters > 5, group.sigmas > 3
    ('Between(x0, x50)', 10, 0.0, True, True)
    """
    whole = graph.pattern(values)
    fixed = fixed_variables(graph.fixed, values)
    pattern = whole.holding(choose_gauge("first", whole, values, fixed | ~touched_variables(whole)).held)
    system = LinearSystem.at(pattern, values)
    groups = list(closure_groups(pattern))
    judged = (_judged(graph, values, pattern, groups[k], common) for k, common in _common(values, system, groups))
    return tuple(sorted((group for group in judged if group is not None), key=lambda group: -group.meters))


@dataclass(frozen=True)
class Common:
    """A common error of a group, in the linear problem.

    Attributes
    ----------
    redundancy : share of it that the residuals show.
    t : its test statistic.
    observable : whether the residuals show every direction of it.
    nabla : (d,) its estimate in the observable directions.
    """

    redundancy: float
    t: float
    observable: bool
    nabla: Array
    _U: sp.csc_array
    _factorization: Factorization

    @property
    def dx(self) -> Array:
        """(n,) step of the map where the group is freed as one."""
        return -self._factorization.solve(self._U @ self.nabla)


def _common(values: Values, system: LinearSystem, groups: Sequence[ClosureGroup]) -> Iterator[tuple[int, Common]]:
    """The number of every group, and the equations of the module for it."""
    try:
        factorization = factorize(system)
    except SingularSystemError as error:
        raise underconstrained(system) from error
    spaces = [system.pattern.batches[group.batch[0]].model.manifolds[0] for group in groups]
    for space in dict.fromkeys(spaces):
        numbers = [k for k, other in enumerate(spaces) if other is space]
        U, Ns, vs = _models(values, system, [groups[k] for k in numbers], space.dim)
        Ms = Ns - factorization.quadratic_forms(U, space.dim)
        for place, (k, N, M, v) in enumerate(zip(numbers, Ns, Ms, vs, strict=True)):
            F = _whitening(N)
            rho, E = np.linalg.eigh(F.T @ M @ F)  # eigenvalues of N^-1 M
            observable = rho > UNSEEN_REDUNDANCY
            along = (F @ E)[:, observable]
            n = along @ (along.T @ v / rho[observable])
            redundancy = float(np.clip(rho, 0, 1).mean()) if len(rho) else 1.0  # without weight it says nothing
            U_k = U[:, place * space.dim : (place + 1) * space.dim]
            yield k, Common(redundancy, float(n @ v), bool(observable.all()), n, U_k, factorization)


def _models(
    values: Values, system: LinearSystem, groups: Sequence[ClosureGroup], d: int
) -> tuple[sp.csc_array, Array, Array]:
    """U = A'C of g groups in a space of d dimensions, side by side (n, g d), N = C'C (g, d, d) and v = C'b (g, d)."""
    batches, index, late = (np.concatenate([getattr(g, name) for g in groups]) for name in ("batch", "index", "late"))
    number = np.repeat(np.arange(len(groups)), [len(group.index) for group in groups])
    first = np.unique(number, return_index=True)[1]  # of the members of every group
    N, v, entries = np.zeros((len(groups), d, d)), np.zeros((len(groups), d)), []
    T_r = np.empty((len(groups), values.stacks[groups[0].kinds[0]].X.shape[1]))
    for b in np.unique(batches):
        batch, blocks, at = system.pattern.batches[b], system.blocks[b], np.flatnonzero(batches == b)
        (_, X), space, k, g = values.gather(batch.model.factor), batch.model.manifolds[0], index[at], number[at]
        assert isinstance(space, LieGroup)
        T_j, A_j = (np.where(late[at].reshape(-1, *[1] * (Y[0].ndim - 1)), Y[1][k], Y[0][k]) for Y in (X, blocks))
        begins = first[g] == at  # of the first batch of a group
        T_r[g[begins]] = T_j[begins]
        C = A_j @ space.adjoint(space.compose(space.inverse(T_j), T_r[g]))
        rows = batch.rows.start + k[:, None] * batch.model.dim + np.arange(batch.model.dim)
        np.add.at(N, g, C.mT @ C)
        np.add.at(v, g, np.matvec(C.mT, system.b[rows]))
        for A, variables in zip(blocks, batch.variables, strict=True):
            start = system.pattern.starts[variables[k]]
            free = start >= 0
            place = start[free, None, None] + np.arange(A.shape[2])[:, None], d * g[free, None, None] + np.arange(d)
            entries.append([a.reshape(-1) for a in np.broadcast_arrays(A[k[free]].mT @ C[free], *place)])
    data, row, column = map(np.concatenate, zip(*entries, strict=True))
    return sp.csc_array(sp.coo_array((data, (row, column)), shape=(system.pattern.n, len(groups) * d))), N, v


def _whitening(N: Array) -> Array:
    """F (d, q) with F'N F = I, q the rank of N; meters and radians in units of their own."""
    scale = 1 / np.sqrt(np.where(np.diagonal(N) > 0, np.diagonal(N), 1.0))
    s, V = np.linalg.eigh(scale[:, None] * N * scale)
    nonzero = s > UNSEEN_REDUNDANCY * s.max()
    return np.asarray(scale[:, None] * V[:, nonzero] / np.sqrt(s[nonzero]))


def _judged(
    graph: FactorGraph, values: Values, pattern: Pattern, group: ClosureGroup, common: Common
) -> Unverified | None:
    """The group, if it is not verified and the map moves without it.

    Groups whose linear step is below half of both bounds are not solved for.
    """
    # a redundancy of 0.1 shows a tenth of a common error; wrong groups that carried manhattan had 1e-8 to 3e-6
    if common.redundancy > 0.1 or (common.observable and common.t < (0.5 * MOVED_SIGMAS) ** 2):
        return None
    before = group.places(values)
    extent = float(np.ptp(before, axis=0).max())
    after = group.places(values.retract(pattern.expand(common.dx)))
    if common.observable and np.square(displacements(before, after)).mean() < (0.5 * PART * extent) ** 2:
        return None
    meters = rms = sigmas = np.inf
    if (solution := _optimum_without(graph, values, group)) is not None:
        optimum, Sigma = solution
        after = group.places(optimum)
        moved, known = displacements(before, after), np.trace(Sigma, axis1=1, axis2=2) > 0
        q = (before - after)[known]
        meters, rms = float(moved.max()), float(np.sqrt(np.square(moved).mean()))
        sigmas = float(np.sqrt(mahalanobis(q, Sigma[known]).max()))
        if rms < PART * extent or sigmas < MOVED_SIGMAS:
            return None
    closures_of = tuple(zip(group.batch.tolist(), group.index.tolist(), strict=True))
    names = tuple(graph.factors[factor].describe(index) for factor, index in closures_of)
    return Unverified(closures_of, names, common.redundancy, meters, rms, sigmas)


def _optimum_without(graph: FactorGraph, values: Values, group: ClosureGroup) -> tuple[Values, Array] | None:
    """The optimum without a group, and covariances (n, k, k) of its positions; None where something is free."""
    masks = [np.ones(len(factor), dtype=bool) for factor in graph.factors]
    for number in np.unique(group.batch):
        masks[number][group.index[group.batch == number]] = False
    subgraph = graph.only(masks)
    parts, fewer = (len(np.unique(component_labels(g.pattern(values)))) for g in (subgraph, graph))
    if parts > fewer:
        return None
    chordal_start = chordal(subgraph, values)
    starts = [values] if chordal_start is values else [values, chordal_start]
    try:
        optimum = min(map(subgraph.optimize, starts), key=lambda result: result.chi2_final).values
        marginals = Marginals(subgraph, optimum)
        Sigma = np.concatenate([marginals.all(Kind(kind), view="position") for kind in group.kinds])
    except UnderconstrainedError:
        return None
    return optimum, Sigma
