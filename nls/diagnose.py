"""What is free and why: variables no factor touches, components nothing anchors, and the null directions by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from models.algebra import Array
from models.errors import UnderconstrainedError

if TYPE_CHECKING:
    from factors.keys import Keys
    from nls.assemble import Index, Pattern
    from nls.system import LinearSystem
    from nls.values import Values

__all__ = ["null_space", "underconstrained"]

MAX_DIRECTIONS = 12  # null directions looked for in one block; more are counted as "at least"
NULL = 1e-9  # |A v| below this for a unit v (columns of A scaled to length 1) is a free direction
SHARE = 0.05  # a variable is named when it moves by at least this part of the farthest moving one
INVOLVED = 0.02  # a component is named when it moves by at least this part of the farthest moving one, in sigmas


def underconstrained(system: LinearSystem, values: Values) -> UnderconstrainedError:
    """The error for a singular system: which variables can move without any measurement noticing, how, and the cures.

    Parameters
    ----------
    system : the linearization that was singular.
    values : the best values so far, for the error to carry.
    """
    pattern = system.pattern
    untouched = np.flatnonzero(system.column_norms == 0.0)
    if len(untouched):
        owner, component = pattern.column_owner()
        named = _by_variable(pattern, owner[untouched], component[untouched])
        return UnderconstrainedError(
            f"{len(untouched)} unknowns have no measurement at all: {_listed(named)}. Remove these variables, add the "
            "factors that are missing, or fix them.",
            [key for key, _ in named],
            len(untouched),
            [text for _, text in named],
            values,
        )
    N = null_space(system)
    if not N.shape[1]:
        return UnderconstrainedError(
            "A'A is singular to rounding although no free direction could be separated: the measurements' weights or "
            "scales differ by more than 13 digits. Check sigmas and units; linear solver 'qr' keeps twice the digits.",
            values=values,
        )
    owner, component = pattern.column_owner()
    carried = _carriers(N, system.column_norms, _component_ids(pattern, owner, component))
    any_of_them = carried.any(axis=1)
    named = _by_variable(pattern, owner[any_of_them], component[any_of_them])
    count = f"at least {MAX_DIRECTIONS}" if N.shape[1] == MAX_DIRECTIONS else str(N.shape[1])
    where, cure = _where(pattern, np.unique(owner[any_of_them]), named)
    return UnderconstrainedError(
        f"the measurements leave {count} direction{'s' if count != '1' else ''} free: {where}. {cure}",
        [key for key, _ in named],
        N.shape[1],
        [_listed(_by_variable(pattern, owner[c], component[c])) for c in carried.T],
        values,
    )


def _component_ids(pattern: Pattern, owner: Index, component: Index) -> Index:
    """A number (n,) per column, the same for columns of one component name: x with x, yaw with yaw."""
    names = [name for manifold in pattern.manifolds.values() for name in manifold.components]
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    start = np.cumsum([0, *(m.dim for m in pattern.manifolds.values())])[:-1]
    kind = np.searchsorted(list(pattern.offsets.values()), owner, side="right") - 1
    return np.array([number[name] for name in names])[start[kind] + component]


def _carriers(N: Array, scale: Array, ids: Index) -> npt.NDArray[np.bool_]:
    """Which unknowns (n, k) carry each free direction: compared among their like, since meters and radians do not.

    A component name counts as involved when, in sigmas, it carries at least INVOLVED of the direction.
    """
    carried = np.zeros(N.shape, dtype=bool)
    sigmas = np.abs(N) * scale[:, None]
    for k in np.unique(ids):
        like = ids == k
        involved = sigmas[like].max(axis=0) >= INVOLVED * sigmas.max(axis=0)
        carried[like] = (np.abs(N[like]) >= SHARE * np.abs(N[like]).max(axis=0)) & involved
    return carried


def null_space(system: LinearSystem) -> Array:
    """Orthonormal free directions (n, k) of a linear system, k at most 12, columns of A scaled to length 1.

    A is tall and sparse: a few rounds of inverse iteration on A'A + 1e-12 I, with the factorization kept, separate what
    no measurement sees. Small systems take the singular value decomposition.
    """
    norms = system.column_norms
    scale = np.where(norms > 0, norms, 1.0)
    n = len(norms)
    A = system.A @ sp.diags_array(1 / scale)
    if n <= 300:
        _, s, Vt = np.linalg.svd(
            A.toarray() if A.shape[0] >= n else np.vstack([A.toarray(), np.zeros((n - A.shape[0], n))])
        )
        return _unscaled(Vt[s <= NULL].T[:, :MAX_DIRECTIONS], scale)
    from scipy.sparse.linalg import splu

    H = sp.csc_matrix(A.T @ A + 1e-12 * sp.eye_array(n))
    factorization = splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    V = np.linalg.qr(np.random.default_rng(0).normal(size=(n, MAX_DIRECTIONS)))[0]
    for _ in range(8):
        V = np.linalg.qr(factorization.solve(V))[0]
    _, s, Wt = np.linalg.svd(A @ V, full_matrices=False)
    return _unscaled((V @ Wt.T)[:, s <= NULL], scale)


def _unscaled(N: Array, scale: Array) -> Array:
    """Directions in the units of the unknowns, each of length 1."""
    N = N / scale[:, None]
    return np.asarray(N / np.linalg.norm(N, axis=0))


def _by_variable(pattern: Pattern, owner: Index, component: Index) -> list[tuple[Keys, str]]:
    """Each variable once, with the names of its components: ``(x3, "x3: x, yaw")``."""
    parts: dict[int, list[str]] = {}
    for v, c in zip(owner, component, strict=True):
        parts.setdefault(int(v), []).append(pattern.component_names(int(v))[int(c)])
    return [(pattern.key(v), f"{pattern.key(v)}: {', '.join(names)}") for v, names in parts.items()]


def _listed(named: list[tuple[Keys, str]]) -> str:
    texts = [text for _, text in named]
    return "; ".join(texts[:6]) + (f"; and {len(texts) - 6} more variables" if len(texts) > 6 else "")


def _where(pattern: Pattern, moving: Index, named: list[tuple[Keys, str]]) -> tuple[str, str]:
    """What moves, in words, and the usual cures: an anchor for whole components, another view for single variables."""
    from nls.gauge import component_labels

    label = component_labels(pattern)
    free = np.flatnonzero(~pattern.held)
    texts = dict(zip(moving.tolist(), (text for _, text in named), strict=True))
    parts = []
    for k in np.unique(label[moving]):
        members = free[label[free] == k]
        if not np.isin(members, moving).all() or (label[pattern.held] == k).any():
            return _listed(named), (
                "Single variables can move: add a prior on them, or a measurement from another place; a landmark needs "
                "two views that differ."
            )
        _, names = texts[int(members[0])].split(": ", 1)
        size = f"all {len(members)} variables joined to" if len(members) > 1 else "the variable"
        parts.append(f"{names} of {size} {pattern.key(int(members[0]))}")
    listed = "; ".join(parts[:6]) + (f"; and {len(parts) - 6} more components" if len(parts) > 6 else "")
    return listed, (
        "Whole components of the graph can move: fix a pose, add a prior to one, choose gauge='first', or join the "
        "components by a measurement."
    )
