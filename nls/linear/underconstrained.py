"""Free directions: variables no factor touches, components nothing anchors, and null directions by name."""

import numpy as np
from scipy import sparse as sp

from factors.keys import Keys
from models.advice import Advice
from models.algebra import Array, Index, Mask
from models.errors import UnderconstrainedError
from models.listing import some
from nls.gauge import component_labels, touched_variables
from nls.linear.base import LinearSolver
from nls.linear.factorization import SingularSystemError, UnsolvedSystemError
from nls.linear.null_space import carriers_of_singles, null_directions, separated, single_directions, weakest
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

TRUNCATED = "nls.Schur(block_inverse=nls.linear.truncated_inverse)"  # as the cure `truncate` writes it
HIDES_ONE = 1e9  # numbers in Jacobians beyond this hide a 1 beside them
ONE_SORT = 1e3  # rows within this factor of the extreme one belong to it: no single measurement is the cause
INVOLVED = 0.02  # a component is named when it moves by at least this part of the farthest moving one, in sigmas


def underconstrained(
    system: LinearSystem,
    values: Values | None = None,
    cause: SingularSystemError | None = None,
    solver: LinearSolver | None = None,
) -> UnderconstrainedError:
    """The error for a singular system: which variables can move without any measurement noticing, how, and the cures.

    Parameters
    ----------
    system : the linearization that was singular.
    values : the best values so far, for the error to carry.
    cause : what the linear solver said. An iteration that did not arrive proves nothing: it speaks for itself.
    solver : the linear solver; no cure asks for it, nor for QR in place of another one that works on A.

    Raises
    ------
    EvaluationError
        Nothing is free: squares of weights or Jacobians overflow.
    """
    if isinstance(cause, UnsolvedSystemError):
        return UnderconstrainedError(str(cause), values=values)
    error = _named(system, values)
    if solver is not None:
        on_A = "linear_solver=nls.QR()" if solver.name in ("qr", "dense-qr", "pinv") else ""
        error.leave_out({on_A, "" if solver.exact else TRUNCATED} - {""})
    return error


def _named(system: LinearSystem, values: Values | None) -> UnderconstrainedError:
    """The error with all its cures."""
    weighted, system = system, system.balanced
    pattern = system.pattern
    owner, component = pattern.column_owner()
    norms = system.column_norms
    if (norms == 0.0).any():
        return _unmeasured(system, norms == 0.0, values)
    moved, more = _moved(system)
    if not moved or _longest(weighted) > HIDES_ONE:
        return _unlike(weighted, values)
    any_of_them = np.unique(np.concatenate(moved))
    named = _by_variable(pattern, owner[any_of_them], component[any_of_them])
    keys = [key for key, _ in named]
    where, advice = _where(pattern, np.unique(owner[any_of_them]), named)
    return UnderconstrainedError(
        f"the measurements leave {directions(len(moved), more)} free: {where}",
        keys,
        len(moved),
        _texts(pattern, moved),
        values,
        advice,
    )


def free_names(system: LinearSystem, left: Array | None = None) -> tuple[str, ...]:
    """Every free direction of a system in words, ``x3: x, yaw``.

    Parameters
    ----------
    system : the linearization.
    left : (n, k) directions that a solver left alone; those in which no measurement reacts when omitted.
    """
    return _texts(system.pattern, _moved(system.balanced if left is None else system, left)[0])


def _moved(system: LinearSystem, left: Array | None = None) -> tuple[list[Index], bool]:
    """The unknowns that each free direction moves, those of single variables first; and whether there may be more.

    Parameters
    ----------
    system : balanced, unless there are directions that a solver left alone: by their scale it chose them.
    left : as for `free_names`.
    """
    norms = np.where(system.column_norms > 0, system.column_norms, 1.0)
    singles, more = sp.csc_array((len(norms), 0)), False
    if left is None:
        singles = single_directions(system)
        left, more = null_directions(system, singles)
    several = separated(left, singles, norms) if left.shape[1] else left
    carried = _carriers(several, norms, _component_ids(system.pattern, *system.pattern.column_owner()))
    moved = [*carriers_of_singles(singles, INVOLVED), *(np.flatnonzero(column) for column in carried.T)]
    return moved, more


def _texts(pattern: Pattern, moved: list[Index]) -> tuple[str, ...]:
    """Each direction in words, from the unknowns it moves."""
    owner, component = pattern.column_owner()
    return tuple(_listed(_by_variable(pattern, owner[unknowns], component[unknowns])) for unknowns in moved)


def _longest(system: LinearSystem) -> float:
    """The largest number in a Jacobian, before it is whitened."""
    ratios = [np.divide(size, weight, out=np.zeros_like(size), where=weight > 0) for weight, size in system.row_sizes]
    return max((float(ratio.max(initial=0.0)) for ratio in ratios), default=0.0)


def _unlike(system: LinearSystem, values: Values | None) -> UnderconstrainedError:
    """The error where nothing is free but rounding hides some measurements beside one that is unlike them.

    Raises
    ------
    EvaluationError
        Squares overflow.
    """
    pattern = system.pattern
    with np.errstate(over="ignore"):
        norms = system.column_norms
    if not np.isfinite(norms).all():
        raise system.overflow()
    batch, index, row, spread, size, advice = _extreme(system)
    keys, where = [key[[index]] for key in pattern.batches[batch].model.factor.keys], ""
    if spread < 1e12 and (norms > 0).all():  # linear solver 'qr' still resolves the spread
        owner, component = pattern.column_owner()
        s, N = weakest(system)
        moved = np.flatnonzero(_carriers(N[:, [np.argmin(s)]], norms, _component_ids(pattern, owner, component))[:, 0])
        named = _by_variable(pattern, owner[moved], component[moved])
        keys = [key for key, _ in named]
        where = f". The weakest direction: {_where(pattern, np.unique(owner[moved]), named)[0]}"
        advice += [Advice("qr"), Advice("tighten"), Advice("fix", ("a variable instead",))]
    return UnderconstrainedError(
        "the measurements determine every unknown, but their weights or scales differ too much for A'A, which keeps "
        f"13 digits. Most unlike the others: {system.scale(batch, index, row)}; {size}{where}",
        keys,
        values=values,
        advice=[*advice, Advice("units")],
    )


def _extreme(system: LinearSystem) -> tuple[int, int, int, float, str, list[Advice]]:
    """The row of A most unlike the others: batch, measurement and row, how far from the median, its size, and advice.

    Where a Jacobian is beyond `HIDES_ONE` it is the row of that kind with the largest measurement: distances enter the
    Jacobians of other measurements, too.
    """
    sizes = [size for _, size in system.row_sizes]
    measured = np.concatenate([size[size > 0] for size in sizes])
    middle = float(np.median(measured))
    if _longest(system) > HIDES_ONE:
        largest = [np.abs(batch.model.z).max(axis=1, initial=0.0) for batch in system.pattern.batches]
        far = [(size > HIDES_ONE * weight).any(axis=1) for weight, size in system.row_sizes]
        values = [np.where(is_far, z, -1.0) for is_far, z in zip(far, largest, strict=True)]
        batch = int(np.argmax([z.max(initial=-1.0) for z in values]))
        index = int(np.argmax(values[batch]))
        row = int(np.argmax(sizes[batch][index]))
        size = f"its measurement is {system.pattern.batches[batch].model.z[index].tolist()}"
        return batch, index, row, np.inf, size, [Advice("inspect", ("that measurement and the initial values",))]
    heavy = measured.max() / middle >= middle / measured.min()
    extreme = measured.max() if heavy else measured.min()
    batch = next(k for k, size in enumerate(sizes) if (size == extreme).any())
    index, row = (int(k) for k in np.argwhere(sizes[batch] == extreme)[0])
    times = float(extreme) / middle
    advice = [Advice("larger sigma" if heavy else "smaller sigma"), Advice("remove", ("it",))]
    size = f"its row of A is {times:.3g} times the median"
    alike = int(((measured > extreme / ONE_SORT) & (measured < extreme * ONE_SORT)).sum())
    if alike > system.pattern.batches[batch].model.dim:
        size += f", and there are {alike:,} rows of about that size"
        advice = [Advice("compare sigmas")]
    return batch, index, row, max(times, 1 / times), size, advice


def directions(count: int, more: bool = False) -> str:
    """The number of free directions in words; and whether there may be more."""
    return "1 direction" if count == 1 else f"{'at least ' if more else ''}{count} directions"


def _unmeasured(system: LinearSystem, zero: Mask, values: Values | None) -> UnderconstrainedError:
    """The error for columns of zeros (n,): nothing touches their variable, or what touches it does not react."""
    pattern = system.pattern
    owner, component = pattern.column_owner()
    touched = touched_variables(pattern)[owner]
    idle, unseen = zero & ~touched, zero & touched
    sentences, advice = [], []
    for unknowns, lack in ((idle, "without any measurement"), (unseen, "not measured")):
        if count := int(unknowns.sum()):
            names = _listed(_by_variable(pattern, owner[unknowns], component[unknowns]))
            some_are = "1 unknown is" if count == 1 else f"{count} unknowns are"
            sentences.append(f"{some_are} {lack}: {names}")
    if idle.any():
        advice = [Advice("factors"), Advice("drop", ("the variable",)), Advice("fix", ("the variable",))]
    silent = _silent(system, owner[unseen])
    if silent is not None:
        factor = pattern.batches[silent[0]].model.factor.describe(silent[1])
        sentences.append(f"cause: {factor} has an information of zero")
        advice += [Advice("smaller sigma"), Advice("measure", ("the component",))]
    elif unseen.any():
        sentences.append(
            "causes: (1) no factor observes it, (2) its Jacobian is zero at these values alone, (3) a robust kernel "
            "rejects its factors"
        )
        advice += [Advice("measure", ("the component",)), Advice("start")]
        advice += [Advice("damp"), Advice("truncate")] if pattern.m >= pattern.n and not zero.all() else []
    named = _by_variable(pattern, owner[zero], component[zero])
    keys, texts = [key for key, _ in named], [text for _, text in named]
    return UnderconstrainedError("; ".join(sentences), keys, int(zero.sum()), texts, values, advice, silent)


def _silent(system: LinearSystem, variables: Index) -> tuple[int, int] | None:
    """Batch and number of the first measurement of some variables that has a row of weight zero, if there is one."""
    for k, (batch, (weights, _)) in enumerate(zip(system.pattern.batches, system.row_sizes, strict=True)):
        touches = np.any([np.isin(slot, variables) for slot in batch.variables], axis=0)
        if (silent := touches & (weights == 0).any(axis=1)).any():
            return k, int(np.argmax(silent))
    return None


def _component_ids(pattern: Pattern, owner: Index, component: Index) -> Index:
    """A number (n,) per column, the same for columns of one component name: x with x, yaw with yaw."""
    names = [name for manifold in pattern.manifolds.values() for name in manifold.components]
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    start = np.cumsum([0, *(m.dim for m in pattern.manifolds.values())])[:-1]
    kind = np.searchsorted(list(pattern.offsets.values()), owner, side="right") - 1
    return np.array([number[name] for name in names])[start[kind] + component]


def _carriers(N: Array, scale: Array, ids: Index) -> Mask:
    """Which unknowns (n, k) carry each free direction: compared among their like, since meters and radians do not.

    A component name counts as involved when, in sigmas, it carries at least INVOLVED of the direction.
    """
    carried = np.zeros(N.shape, dtype=bool)
    sigmas = np.abs(N) * scale[:, None]
    for k in np.unique(ids):
        like = ids == k
        involved = sigmas[like].max(axis=0) >= INVOLVED * sigmas.max(axis=0)
        # an unknown is named when it moves by at least 0.05 of the farthest moving one
        carried[like] = (np.abs(N[like]) >= 0.05 * np.abs(N[like]).max(axis=0)) & involved
    return carried


def _by_variable(pattern: Pattern, owner: Index, component: Index) -> list[tuple[Keys, str]]:
    """Each variable once, with the names of its components: ``(x3, "x3: x, yaw")``."""
    parts: dict[int, list[str]] = {}
    for v, c in zip(owner, component, strict=True):
        parts.setdefault(int(v), []).append(pattern.component_names(int(v))[int(c)])
    return [(pattern.key(v), f"{pattern.key(v)}: {', '.join(names)}") for v, names in parts.items()]


def _listed(named: list[tuple[Keys, str]]) -> str:
    return some([text for _, text in named], 6, "; ", " variables")


def _poses(pattern: Pattern, variables: Index) -> bool:
    """Whether poses are among some variables."""
    return any(pattern.manifolds[pattern.key(int(v)).kind].body_axes for v in variables)


def _where(pattern: Pattern, moving: Index, named: list[tuple[Keys, str]]) -> tuple[str, list[Advice]]:
    """The moving variables in words, and cures: an anchor for whole components, another view for single variables."""
    label = component_labels(pattern)
    free = np.flatnonzero(~pattern.held)
    texts = dict(zip(moving.tolist(), (text for _, text in named), strict=True))
    parts = []
    for k in np.unique(label[moving]):
        members = free[label[free] == k]
        held = np.flatnonzero(pattern.held & (label == k))
        if len(held) or not np.isin(members, moving).all():
            turns = len(held) > 0 and not _poses(pattern, held) and _poses(pattern, moving[label[moving] == k])
            cure = Advice("fix", ("a pose",)) if turns else Advice("view", ("a landmark",))
            return _listed(named), [cure, Advice("prior", ("the variables",))]
        _, names = texts[int(members[0])].split(": ", 1)
        size = f"all {len(members)} variables connected to" if len(members) > 1 else "the variable"
        parts.append(f"{names} of {size} {pattern.key(int(members[0]))}")
    listed = some(parts, 6, "; ", " components")
    components = np.unique(label[moving])
    anchors: dict[int, str] = {}  # component -> a factor that keeps the gauge from being held there
    for batch in pattern.batches:
        if not batch.model.factor.relative:
            at, first = np.unique(label[batch.variables[0]], return_index=True)
            for k in np.flatnonzero(np.isin(at, components)):
                anchors.setdefault(int(at[k]), batch.model.factor.describe(int(first[k])))
    advice = [Advice("fix", ("a pose",)), Advice("prior", ("one pose",))]
    advice += [] if len(anchors) == len(components) else [Advice("gauge")]
    advice += [Advice("join")] if len(np.unique(label[touched_variables(pattern)])) > 1 else []
    advice += [Advice("relative", (factor,)) for factor in list(anchors.values())[:1]]
    return listed, advice
