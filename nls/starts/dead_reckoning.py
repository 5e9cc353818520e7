"""Dead reckoning: poses in space from steps in the horizontal, with depth, pitch and roll as they were measured.

The levelled step of `XYH` is the difference of two poses of the plane, (x, y, yaw) of SE(2), so its chain is the chain
of SE(2); z, pitch and roll are not integrated, `ZPR` has them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.keys import Keys
from factors.xyh import XYH
from factors.zpr import ZPR
from models import SE2, SE3, euler
from models.algebra import Array
from models.errors import SingularGeometryError
from models.sensors.heading import refuse_gimbal_lock
from models.sensors.singular import SingularAt
from nls.graph import FactorGraph
from nls.starts.chain import along_chain
from nls.starts.edges import PoseEdges, edges_of
from nls.values import Values

__all__ = ["dead_reckoning", "walks"]

X_Y_YAW, Z_PITCH_ROLL = [3, 4, 2], [5, 1, 0]  # places in the Euler vector (roll, pitch, yaw, x, y, z)


def walks(graph: FactorGraph) -> bool:
    """Whether the graph has steps to reckon with."""
    return any(isinstance(factor, XYH) and len(factor) for factor in graph.factors)


def dead_reckoning(graph: FactorGraph, values: Values) -> Values:
    """Poses chained from `XYH`, from one number to the next, with z, pitch and roll of `ZPR`.

    Fixed poses keep their values; in a component without any, the first pose keeps its x, y and yaw. Poses without a
    `ZPR` keep their z, pitch and roll, poses without an `XYH` everything.

    Parameters
    ----------
    graph : its `XYH` and `ZPR` factors are used, whatever their noise; where two neighbors in number have no common
        step, the one that jumps over the fewest numbers, as in `chain`. The form ``relative`` is taken for levelled,
        which it is to first order in the tilt.
    values : every variable.

    Returns
    -------
    Values

    Raises
    ------
    SingularGeometryError
        A pose whose yaw or tilt is to be kept is at gimbal lock.

    Examples
    --------
    >>> from factors import XYH, ZPR, Isotropic
    >>> from models import SE3, euler
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.starts import dead_reckoning
    >>> (x,) = kinds("x")
    >>> ahead_and_turn = XYH(x[[0, 1]], x[[1, 2]], [[1, 0, 1.5], [1, 0, 0]], Isotropic(1))
    >>> tilt = ZPR(x[2], [5.0, 0.1, -0.2], Isotropic(1))
    >>> found = dead_reckoning(FactorGraph([ahead_and_turn, tilt]), Values({x: (SE3, SE3.identity(3))}))
    >>> euler.from_se3(found[x[2]]).round(3)  # roll, pitch, yaw, x, y, z
    array([-0.2  ,  0.1  ,  1.5  ,  1.071,  0.997,  5.   ])
    """
    batches = [batch for batch in graph.pattern(values).batches if isinstance(batch.model.factor, XYH) and len(batch)]
    if not batches:
        return values
    edges = edges_of(graph, values, batches, SE3, SE2)
    X = np.array(edges.stack(values))
    tilt, measured = _tilts(graph, values, edges)

    kept = edges.touched & ~measured  # their z, pitch and roll
    kept[edges.roots[edges.touched[edges.roots]]] = True  # their x, y and yaw
    state = np.zeros((edges.n, 6))
    state[kept] = _euler(values, edges, X, kept)
    state[:, Z_PITCH_ROLL] = np.where(measured[:, None], tilt, state[:, Z_PITCH_ROLL])
    state[:, X_Y_YAW] = along_chain(edges, state[:, X_Y_YAW])

    moved = edges.touched & ~edges.fixed
    X[moved] = euler.to_se3(state[moved])
    return edges.replaced(values, X)


def _tilts(graph: FactorGraph, values: Values, edges: PoseEdges) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Measured z, pitch and roll (n, 3) of the nodes, and which nodes (n,) have them."""
    sizes = [len(values.stacks[kind]) for kind in edges.kinds]
    first = dict(zip(edges.kinds, np.cumsum([0, *sizes]), strict=False))
    tilt, measured = np.zeros((edges.n, 3)), np.zeros(edges.n, dtype=bool)
    for batch in graph.pattern(values).batches:
        if isinstance(batch.model.factor, ZPR):
            nodes = first[batch.kinds[0]] + batch.index[0]
            tilt[nodes], measured[nodes] = batch.model.z, True
    return tilt, measured


def _euler(values: Values, edges: PoseEdges, X: Array, kept: npt.NDArray[np.bool_]) -> Array:
    """Euler 6-vectors of some nodes, named where they have none."""
    R = SE3.rotation(X[kept])
    try:
        refuse_gimbal_lock(R)
    except SingularAt as error:
        names = [key for kind in edges.kinds for key in Keys(kind, values.stacks[kind].numbers)]
        key = names[np.flatnonzero(kept)[error.index]]
        message = f"dead reckoning from {key}: {error}"
        raise SingularGeometryError(message, keys=[key]) from error
    return euler.from_se3(X[kept])
