r"""How many measured numbers check the position of dead reckoning, how well it is known where none does, and which
errors of a whole table stay hidden.

A raw log measures depth and attitude at each pose and a step to the next. These are as many numbers as unknowns, so
whatever the DVL says fits. The degrees of freedom left for the position are those of the graph without those of the
yaw:

    checks = dof - max(0, headings + turns - poses)

with `Heading` as headings, and the rows of `XYH` that say the turn and nothing of x and y as turns.

A heading that is turned, a depth with another zero, a place, a clock or an arm of fixes that is wrong is one error
nabla of all rows of a table, C nabla in their whitened residuals. The optimum takes up a part of it, and chi2 grows by

    nabla'M nabla,    M = C'(I - A (A'A)^-1 A') C,

see `nls.analysis.redundancy`. A random walk of motion.csv measures nothing and shows no error: its rows
hardly count. The error is hidden while chi2 stays plausible, below twice its degrees of freedom:

    |nabla| < sqrt((2 dof - chi2) / lambda_min(M))

Source: W. Baarda, "A testing procedure for use in geodetic networks", 1968, internal reliability.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factors import XYH, Heading, Position
from factors.keys import kinds
from models.algebra import Array, apply
from models.manifolds.so3 import rotation3
from nls.covariance import Marginals
from nls.gauge import choose_gauge, fixed_variables, touched_variables
from nls.graph import FactorGraph
from nls.io.mission.report import MissionReport
from nls.linear import factorize
from nls.linear.singular import SingularSystemError
from nls.optimizers.fit import TWICE
from nls.sparse.pattern import Batch
from nls.sparse.threads import single_thread
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["Hidden", "hidden_errors", "position_checks", "sigma_at_the_end"]
YAW = 2  # column of XYH
ROUNDING = 1e-9  # part of an error that rounding shows
WALK = 1e-3  # part of the weight of a random walk that counts, so that no pose is free
LEAST = {"heading": 0.2, "depth": 1.0, "zero of the depth": 2.0, "place": 10.0, "clock": 2.0, "arm": 5.0}  # that matter
MOST = {"heading": 1.0, "depth": 1.0, "clock": 3600.0, "arm": 100.0}  # beyond which any is: a turn is not linear
(x,) = kinds("x")


def position_checks(graph: FactorGraph, values: Values, dof: int) -> int:
    """Measured numbers beyond those that say where the vehicle is: 0 where nothing checks dead reckoning.

    Parameters
    ----------
    graph, values : of a mission, with poses ``x``.
    dof : degrees of freedom of the graph.
    """
    headings = sum(len(factor) for factor in graph.factors if isinstance(factor, Heading))
    turns = sum(_turns(factor, values) for factor in graph.factors if isinstance(factor, XYH))
    return max(0, dof - max(0, headings + turns - len(values.stack("x"))))


def _turns(factor: XYH, values: Values) -> int:
    """Rows of a batch of steps that measure the yaw, and neither x nor y."""
    W = values.gather(factor)[0].W
    if W.ndim == 2:
        rows = int((W[:, YAW] != 0).sum())
    else:
        rows = int(((W[:, :, YAW] != 0) & (W[:, :, :YAW] == 0).all(axis=2)).sum())
    return rows * (len(factor) if len(W) == 1 else 1)


def sigma_at_the_end(marginals: Marginals, report: MissionReport) -> float:
    """Standard deviation of the distance of the last pose from the true one, m: the root of the trace of its x, y, z.

    Raises
    ------
    UnderconstrainedError
        It is free.
    """
    numbers = marginals.values.stack("x").numbers
    last = int(numbers[np.argmax(report.vertex_times.get("x", numbers))])
    return float(np.sqrt(np.trace(marginals.covariance(x[last], view="position"))))


@dataclass(frozen=True)
class Hidden:
    """An error of all rows of a table that would not be seen.

    Attributes
    ----------
    file : of the table.
    quantity : ``heading``, ``depth`` (its zero and its scale), ``zero of the depth``, ``place``, ``clock`` or ``arm``.
    below : the size that would be seen, rad, m or s; infinite where none is, or nearly so.
    """

    file: str
    quantity: str
    below: float


@single_thread()
def hidden_errors(graph: FactorGraph, values: Values, chi2: float, dof: int, report: MissionReport) -> list[Hidden]:
    """Errors of whole tables that no other measurement would show; none where something is free.

    Parameters
    ----------
    graph, values, chi2, dof : of a mission, its optimum.
    report : of its folder.
    """
    whole = graph.pattern(values)
    fixed = fixed_variables(graph.fixed, values) | ~touched_variables(whole)
    pattern = whole.holding(choose_gauge("first", whole, values, fixed).held)
    linear = LinearSystem.at(pattern, values)
    blocks, errors = list(linear.blocks), dict[tuple[str, str], Array]()
    for k, (batch, source) in enumerate(zip(pattern.batches, report.sources, strict=False)):
        if Path(source.path).name == "motion.csv":
            blocks[k] = tuple(WALK * A for A in blocks[k])
            continue
        if batch.model.factor.limit_only or not source.lines.any():
            continue
        weights = np.sqrt(batch.model.factor.weights(values))[:, None, None]
        for quantity, C in _errors(batch, values, report):
            rows = errors.setdefault((Path(source.path).name, quantity), np.zeros((pattern.m, C.shape[2])))
            rows[batch.rows] += (weights * C).reshape(-1, C.shape[2])
    if not errors:
        return []
    system = LinearSystem(pattern, blocks, linear.b)
    all_C = np.concatenate(list(errors.values()), axis=1)
    U = system.A.T @ all_C
    try:
        taken = all_C - system.A @ factorize(system).solve(U)
    except SingularSystemError:
        return []
    out, first, slack = [], 0, max(TWICE * dof - chi2, 1.0)
    for (file, quantity), C in errors.items():
        left = taken[:, first : first + C.shape[1]]
        first += C.shape[1]
        M, largest = left.T @ left, float(np.linalg.eigvalsh(C.T @ C).max())
        shown = float(np.linalg.eigvalsh(M).min())
        below = float(np.sqrt(slack / shown)) if shown > ROUNDING * largest else np.inf
        if below > LEAST[quantity]:
            out.append(Hidden(file, quantity, below if below < MOST.get(quantity, np.inf) else np.inf))
    wholly = {error.file for error in out if error.quantity == "depth"}
    return [error for error in out if error.quantity != "zero of the depth" or error.file not in wholly]


def _errors(batch: Batch, values: Values, report: MissionReport) -> Iterator[tuple[str, Array]]:
    """What may be wrong with all measurements of a factor: its name, and C (n, m, k) of k numbers."""
    factor, W = batch.model.factor, batch.model.W
    W = W if W.ndim == 3 else W[:, :, None] * np.eye(W.shape[1])
    W = np.broadcast_to(W, (len(batch), *W.shape[1:]))
    if len(batch) == 1:
        return
    if (tilts := factor.tilts(batch.model)) is not None:
        yield "zero of the depth", W[:, :, :1]
        if "dvl.csv" not in report.tags:  # the checks before the graph compare it with the way down
            yield "depth", W[:, :, :1] * (tilts[:, :1] - tilts[:, :1].mean())[:, :, None]
    elif isinstance(factor, Heading):
        yield "heading", W[:, :, :1]
    elif isinstance(factor, Position):
        X, t, W = values.stack("x"), report.vertex_times.get("x"), W[:, :, :2]
        at = X.index(factor.keys[0])
        yield "place", W
        if t is not None and (np.diff(t) > 0).all():
            yield "clock", apply(W, np.gradient(X.X[:, :2], t, axis=0)[at])[:, :, None]
        if np.any(factor.offset):
            yield "arm", W @ rotation3(X.X[at, 3:])[:, :2, :2]
