"""A start for measurements in another frame: odometry as a whole moved onto the positions that were measured."""

from __future__ import annotations

import numpy as np

from factors import Position, Sighting
from models import SE2, SE3
from models.alignment import align
from models.errors import UnderconstrainedError
from nls.graph import FactorGraph
from nls.starts import initialize
from nls.values import Values


def aligned(graph: FactorGraph, values: Values) -> Values:
    """Poses chained by odometry and points seen from them, all moved by one motion onto the measured positions.

    Parameters
    ----------
    graph : its `Position` factors of all coordinates say where the poses are.
    values : every variable.

    Raises
    ------
    UnderconstrainedError
        No positions are measured.
    SingularGeometryError
        The positions leave a rotation free.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> step = Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.0], Isotropic(0.1))
    >>> fixes = Position(x[[0, 2]], [[5.0, 1.0], [5.0, 3.0]], Isotropic(0.1))
    >>> aligned(FactorGraph([step, fixes]), Values({x: (SE2, SE2.identity(3))}))[x].round(3).tolist()
    [[5.0, 1.0, 1.571], [5.0, 2.0, 1.571], [5.0, 3.0, 1.571]]
    """
    fixes = [f for f in graph.factors if isinstance(f, Position) and f.components is None]
    groups = {values.gather(factor)[0].manifolds[0] for factor in fixes}
    if len(groups) != 1:
        raise UnderconstrainedError("no positions are measured in one group of poses")
    (group,) = groups
    assert group in (SE2, SE3)
    start = initialize(graph, values, "odometry")[0]
    measured, positions = [], []
    for factor in fixes:
        model, X = start.gather(factor)
        measured.append(model.z)
        positions.append(model.factor.predict(model.manifolds, *X)[0])
    T = align(np.concatenate(measured), np.concatenate(positions))
    points = {factor.keys[1].kind for factor in graph.factors if isinstance(factor, Sighting)}
    moved = {}
    for kind, stack in start.stacks.items():
        if stack.manifold is group:
            moved[kind] = group.compose(T, stack.X)
        elif kind in points:
            moved[kind] = group.act(T, stack.X)
    return start.replaced(moved)
