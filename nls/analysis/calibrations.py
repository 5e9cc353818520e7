r"""Calibrations that explain chi2: where a sensor sits on the vehicle, and the scale and turn of odometry.

Each is a variable c with a wide prior, estimated with everything else. First one Gauss-Newton step at the optimum
without it says by how much chi2 would fall,

    2 dx'A'b - |A dx|^2  ~  chi2(dim c)          without an error there

the score test (C. R. Rao, "Large sample tests of statistical hypotheses", 1948). With J the columns of c it is

    g'H^-1 g + r'S^-1 r,    r = J'b - B'H^-1 g,    S = J'J + I / sigma^2 - B'H^-1 B,    B = A'J,    g = A'b

so that H = A'A is factorized once, without c. A variable with a free direction says nothing about c and is left out,
with its measurements. The J of odometry is that of the estimated steps. The measured ones share their noise with b:
scaled down they always fit better. Where the fall is no chance the graph is solved with c. Calibrations whose chi2
differ by no more than chance cannot be distinguished.

The step of odometry z is h o Exp(G c) with c its scale error and the turn of its axes,

    G = [(R'p; 0), (Ad(z)^-1 - I) of the rotations]         z = (R, p), a pose
    G = [(x, y, 0), (-y, x, 0)]                             z = (x, y, yaw)
"""

from dataclasses import dataclass

import numpy as np

from factors import Factor, Isotropic, Prior, Shifted, Sighting
from factors.keys import Keys, Kind
from factors.replaced import predicted
from models import SE2, SE3, LieGroup, R
from models.algebra import Array, Index
from models.chi_squared import chi2_tail
from nls.analysis.alternatives import EQUAL, Fit, Judged, expected, nearest, scale, solved
from nls.analysis.freedom import Freedom, freedom
from nls.analysis.leave_one_out import Checked
from nls.covariance import Marginals
from nls.gauge import choose_gauge, fixed_variables
from nls.graph import FactorGraph
from nls.posegraph import odometry
from nls.sparse.pattern import Pattern
from nls.starts.parts import Parts
from nls.system import LinearSystem
from nls.values import Values

CLEAR_SIGMAS = 3.0  # of a component that is named
MEASUREMENTS = 6  # at least, of a sensor or of odometry


@dataclass(frozen=True)
class Calibration:
    """A calibration that explains chi2.

    Attributes
    ----------
    kind : types of its measurements, ``RangeAzimuth``.
    quantity : ``mounting`` or ``odometry``.
    components : those that are off. Of a mounting in the axes of the vehicle; of odometry ``scale`` and turns.
    correction : of each, m or rad, to be added to the mounting as given. Of odometry ``scale`` is measured over true
        length, and the turn that of its axes.
    sigma : of each.
    standing, chi2 : of the graph without it and with it.
    dof : degrees of freedom without it.
    """

    kind: str
    quantity: str
    components: tuple[str, ...]
    correction: Array
    sigma: Array
    standing: float
    chi2: float
    dof: int


@dataclass(frozen=True)
class Source:
    """One calibration as a variable.

    Attributes
    ----------
    kind, quantity : as of `Calibration`.
    components : of the variable.
    factors : all of the graph, with the variable in those that depend on it.
    changed : the latter, for the score test.
    group, X : space and start of the variable.
    sigma : of its prior.
    """

    kind: str
    quantity: str
    components: tuple[str, ...]
    factors: tuple[Factor, ...]
    changed: tuple[Factor, ...]
    group: LieGroup
    X: Array
    sigma: float


def calibrations(graph: FactorGraph, values: Values, free: Freedom | None = None) -> tuple[Calibration, ...]:
    """Calibrations that explain chi2: noise explains the rest, or nine tenths of its excess are gone.

    Parameters
    ----------
    graph : not changed. Variables with a free direction are left out, with their measurements.
    values : its optimum.
    free : the free directions there, where these are at hand.

    Returns
    -------
    tuple of Calibration
        The lowest chi2 first. The data do not distinguish several ones. None where a free direction moves
        several variables.

    Raises
    ------
    ResourceLimitError
        The covariances of what is determined would need more than half of the memory.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from factors.replaced import replaced
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> first, odometry, sightings = world.graph.factors
    >>> turned = FactorGraph([first, odometry, replaced(sightings, z=sightings.z + [0.1, 0])])
    >>> for wrong in calibrations(turned, turned.optimize(world.start).values):
    ...     print(wrong.kind, wrong.quantity, wrong.components, wrong.correction.round(2))
    Between odometry ('yaw',) [-0.1]
    BearingRange mounting ('yaw',) [-0.1]
    """
    whole = graph.pattern(values)
    gauge = choose_gauge("first", whole, values, fixed_variables(graph.fixed, values))
    pattern = whole.holding(gauge.held)
    free = free or freedom(pattern, values)
    if free.checked is None or free.combinations.size:
        return ()
    if free.count:
        return calibrations(*_determined(graph, pattern, values, free))
    key = _unused(values)
    sources = [*_mountings(graph, pattern, key), *_odometry(graph, pattern, values, key)]
    held = [*graph.fixed, *(pattern.key(int(v)) for v in np.flatnonzero(gauge.held & ~gauge.fixed))]
    chi2, dof = graph.chi2(values), pattern.measured_rows - pattern.n
    fits: list[Calibration] = []
    for source in sources:
        other = FactorGraph([*source.factors, Prior(key, source.X, Isotropic(source.sigma))], held)
        start = Values.of(values.stacks.values())
        start.add(Kind(key.kind), source.group, source.X)
        try:
            fall = _fall(FactorGraph(list(source.changed), held).linearize(start), free.checked, source.sigma)
        except np.linalg.LinAlgError:  # the optimum is at numbers beside which the calibration has no digits left
            continue
        variance, d = max(1.0, (chi2 - fall) / max(dof, 1)), source.group.dim
        if len(sources) * float(chi2_tail(np.array(fall / variance), np.array(d))) > 1e-6:
            continue  # a false alarm is as likely: no noise is exactly as stated; the public smallGrid3D has 4e-5
        fit = solved(other, start, start=False)
        if fit is None or chi2 - fit.chi2 < EQUAL * scale(fit):
            continue
        if np.abs(source.group.log(source.group.between(source.X, fit.values[key][None]))).max() > 1.6:
            continue  # m, rad, or a fraction: beyond a quarter turn it is another mistake
        if explains(fit, chi2, dof):
            fits.append(_named(source, fit, key, chi2, dof))
    return nearest(fits)


def explains(fit: Judged, chi2: float, dof: int) -> bool:
    """Whether noise explains an optimum, or nine tenths of the excess of chi2 over dof are gone.

    Odometry without use explains three quarters.
    """
    return expected(fit) or chi2 - fit.chi2 > 0.9 * (chi2 - dof)


def _determined(graph: FactorGraph, pattern: Pattern, values: Values, free: Freedom) -> tuple[FactorGraph, Values]:
    """The measurements of no variable that has a free direction, and the variables they touch.

    A factor from a function is one measurement.
    """
    loose = np.zeros(len(pattern.dims), dtype=bool)
    loose[pattern.column_owner()[0][free.singles.indices]] = True
    kept = [~np.any([loose[variables] for variables in batch.variables], axis=0) for batch in pattern.batches]
    kept = [rows & (rows.all() or not f.opaque) for rows, f in zip(kept, graph.factors, strict=True)]
    return Parts(graph, values).take(kept, {}, values)


def _fall(system: LinearSystem, standing: Checked, sigma: float) -> float:
    """By how much chi2 falls with a calibration.

    Parameters
    ----------
    system : of the measurements that depend on it; its columns are the last ones.
    standing : of all measurements without it.
    sigma : of its prior.
    """
    A, n, x = system.A, len(standing.dx), standing.dx
    J = A @ np.eye(A.shape[1], A.shape[1] - n, -n)
    B, M = np.split(A.T @ J, [n])
    r = J.T @ system.b - B.T @ x
    S = M + np.eye(len(r)) / sigma**2 - B.T @ standing.factorization.solve(B)
    return standing.promised + float(np.square(np.linalg.solve(np.linalg.cholesky(S), r)).sum())


def _unused(values: Values) -> Keys:
    """A variable of a kind that has no values."""
    name = "calibration"
    while name in values.stacks:
        name += "_"
    return Kind(name)[0]


def _mountings(graph: FactorGraph, pattern: Pattern, key: Keys) -> list[Source]:
    """The known place of every sensor on the vehicle: sightings with the same offset are of one sensor."""
    sensors: dict[tuple[LieGroup, bytes], tuple[Array, list[int]]] = {}
    for k, (factor, batch) in enumerate(zip(graph.factors, pattern.batches, strict=True)):
        group = batch.model.manifolds[0]
        if not isinstance(factor, Sighting) or group not in (SE2, SE3):
            continue
        assert isinstance(group, LieGroup)
        O = group.identity(1) if factor.offset is None else factor.offset
        if not isinstance(O, Keys) and len(O) == 1:
            sensors.setdefault((group, O.tobytes()), (O, []))[1].append(k)
    sources = []
    for (group, _), (O, numbers) in sensors.items():
        measuring = [graph.factors[k] for k in numbers if not graph.factors[k].limit_only]
        if sum(map(len, measuring)) < MEASUREMENTS:
            continue
        factors = list(graph.factors)
        for k in numbers:
            sighting = factors[k]
            assert isinstance(sighting, Sighting)
            factors[k] = sighting.mounted(key)
        kind = " and ".join(dict.fromkeys(factor.name for factor in measuring))
        changed = tuple(factors[k] for k in numbers)
        # 0.1 m and rad: with a wider prior a direction that is hardly seen leads to another optimum
        sources.append(Source(kind, "mounting", group.components, tuple(factors), changed, group, O, 0.1))
    return sources


def _odometry(graph: FactorGraph, pattern: Pattern, values: Values, key: Keys) -> list[Source]:
    """Scale error and turned axes of the steps of each space: poses, or x, y and yaw."""
    steps: dict[LieGroup, list[tuple[int, Index]]] = {}
    for k, (batch, consecutive) in enumerate(zip(pattern.batches, odometry(pattern), strict=True)):
        space, along = batch.model.space, consecutive | batch.model.factor.states("level_steps")
        if batch.model.factor.frame == "first" and isinstance(space, LieGroup) and along.any():
            steps.setdefault(space, []).append((k, np.flatnonzero(along)))
    sources = []
    for space, places in steps.items():
        if sum(len(indices) for _, indices in places) < MEASUREMENTS or not {"x", "y", "yaw"} <= {*space.components}:
            continue
        turns = tuple(name for name in space.components if name not in {*"xyz"}) if space in (SE2, SE3) else ("yaw",)
        factors, changed = list(graph.factors), []
        for k, indices in places:
            factor, model = graph.factors[k], pattern.batches[k].model
            rest, own_steps = np.setdiff1d(np.arange(len(factor)), indices), factor[indices]
            factors[k] = Shifted(own_steps, _rates(space, model.z[indices]), key)
            factors += [factor[rest]] if len(rest) else []
            changed.append(Shifted(own_steps, _rates(space, predicted(own_steps, own_steps.keys, values).z), key))
        kind = " and ".join(dict.fromkeys(graph.factors[k].name for k, _ in places))
        group = R(1 + len(turns))
        begin = np.zeros((1, group.dim))
        sources.append(Source(kind, "odometry", ("scale", *turns), tuple(factors), tuple(changed), group, begin, 1.0))
    return sources


def _rates(space: LieGroup, z: Array) -> Array:
    """G (n, m, k) of steps z (n, size): their scale error and the turn of their axes."""
    G = np.zeros((len(z), space.dim, 1))
    if space not in (SE2, SE3):  # named numbers
        x, y = (space.components.index(name) for name in "xy")
        turn = np.zeros_like(G)
        G[:, x, 0], G[:, y, 0] = z[:, x], z[:, y]
        turn[:, x, 0], turn[:, y, 0] = -z[:, y], z[:, x]
        return np.concatenate([G, turn], axis=2)
    d = space.point_dim
    G[:, :d, 0] = np.matvec(space.rotation(z).mT, space.position(z))
    return np.concatenate([G, (space.adjoint_inverse(z) - np.eye(space.dim))[:, :, d:]], axis=2)


def _named(source: Source, fit: Fit, key: Keys, chi2: float, dof: int) -> Calibration:
    """The components of a calibration that are off, in the axes of the vehicle."""
    X = fit.values[key][None]
    G = source.group.world_axes(X)[0]
    sigma = np.sqrt(np.diagonal(Marginals(fit.graph, fit.values).covariance(key, frame="world")))
    correction = G @ source.group.log(source.group.between(source.X, X))[0]
    if source.quantity == "mounting":  # the difference of places, not of tangent vectors
        d = source.group.point_dim
        correction[:d] = (source.group.position(X) - source.group.position(source.X))[0]
    off = np.flatnonzero(np.abs(correction) > CLEAR_SIGMAS * sigma)
    if source.quantity == "odometry":  # z - G c is z times a scale and a rotation
        along, turn = 1 - correction[0], float(np.linalg.norm(correction[1:]))
        correction[1:] *= np.arctan2(turn, along) / turn if turn > 0 else 1.0
        correction[0] = 1 / np.hypot(along, turn)
        off = np.flatnonzero(np.abs(correction - np.eye(len(correction))[0]) > CLEAR_SIGMAS * sigma)
    names = tuple(source.components[c] for c in off)
    return Calibration(source.kind, source.quantity, names, correction[off], sigma[off], chi2, fit.chi2, dof)
