"""Starts composed along edges: the odometry chain, the spanning tree of fewest steps, and dead reckoning in space.

Dead reckoning takes steps in the horizontal, with depth, pitch and roll as they were measured. The levelled step of
`XYH` is the difference of two poses of the plane, (x, y, yaw) of SE(2). So its chain is the chain of SE(2); z, pitch
and roll are not integrated, `ZPR` has them.
"""

import numpy as np

from models import SE2, SE3, Measured, euler
from models.algebra import Array, Mask
from models.errors import SingularGeometryError
from models.sensors.heading import refuse_gimbal_lock
from models.sensors.singular import SingularAt
from nls.gauge import fixed_variables
from nls.graph import FactorGraph
from nls.posegraph import PoseGraph, pose_graphs, stated
from nls.values import Values, refuse_other

X_Y_YAW, Z_PITCH_ROLL = [3, 4, 2], [5, 1, 0]  # places in the Euler vector (roll, pitch, yaw, x, y, z)


def chain(graph: FactorGraph, values: Values) -> Values:
    """Poses composed from one number to the next: the dead-reckoned trajectory.

    Where two neighbors in number have no common edge, the edge that jumps over the fewest numbers is taken. This is a
    minimum spanning tree over the difference of places. Fixed poses keep their values; in a component without any, the
    first pose does.

    Parameters
    ----------
    graph : its relative poses are used, see `Factor.relative_poses`, whatever their noise.
    values : every variable; only the first poses matter.

    Returns
    -------
    Values

    Examples
    --------
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.starts import chain
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [[1, 0, 1.5], [1, 0, 0]], Isotropic(1))])
    >>> chain(graph, Values({x: (SE2, SE2.identity(3))}))[x].round(3).tolist()
    [[0.0, 0.0, 0.0], [1.0, 0.0, 1.5], [1.071, 0.997, 1.5]]
    """
    for poses in pose_graphs(graph, values):
        values = poses.replaced(values, poses.along(poses.odometry_tree(), poses.stack(values)))
    return values


def spanning_tree(graph: FactorGraph, values: Values) -> Values:
    """Poses composed along the tree of fewest edges from the first pose of every component.

    Parameters and result as for `chain`. Loop closures shorten the way, so errors of odometry add up over fewer steps;
    a wrong closure bends everything behind it.
    """
    refuse_other("spanning_tree", graph, values)
    for poses in pose_graphs(graph, values):
        values = poses.replaced(values, poses.along(poses.tree(poses.pairs()), poses.stack(values)))
    return values


def walks(graph: FactorGraph) -> bool:
    """Whether the graph has steps to reckon with."""
    return any(factor.states("level_steps") and len(factor) for factor in graph.factors)


def dead_reckoning(graph: FactorGraph, values: Values) -> Values:
    """Poses chained from `XYH` and its like, from one number to the next, with z, pitch and roll of `ZPR`.

    Fixed poses keep their values; in a component without any, the first pose keeps its x, y and yaw. Poses without a
    `ZPR` keep their z, pitch and roll, poses without an `XYH` everything.

    Parameters
    ----------
    graph : its `Factor.level_steps` and `Factor.tilts` are used, whatever their noise; where two neighbors in number
        have no common step, the one that jumps over the fewest numbers, as in `chain`. The form ``relative`` of `XYH`
        is taken for levelled, which it is to first order in the tilt.
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
    >>> start = dead_reckoning(FactorGraph([ahead_and_turn, tilt]), Values({x: (SE3, SE3.identity(3))}))
    >>> euler.from_se3(start[x[2]]).round(3)  # roll, pitch, yaw, x, y, z
    array([-0.2  ,  0.1  ,  1.5  ,  1.071,  0.997,  5.   ])
    """
    pattern = graph.pattern(values)
    steps = [(b, z) for b in pattern.batches if (z := stated(b, "level_steps", SE2)) is not None]
    if not steps:
        return values
    poses = PoseGraph(pattern, fixed_variables(graph.fixed, values), SE2, steps)
    X = np.array(poses.stack(values))
    tilt, measured = _tilts(poses)

    nodes = poses.touched & ~measured  # that keep z, pitch and roll
    nodes[poses.roots[poses.touched[poses.roots]]] = True  # that keep x, y and yaw
    state = np.zeros((poses.n, 6))
    state[nodes] = _euler(poses, X, nodes)
    state[:, Z_PITCH_ROLL] = np.where(measured[:, None], tilt, state[:, Z_PITCH_ROLL])
    state[:, X_Y_YAW] = poses.along(poses.odometry_tree(), state[:, X_Y_YAW])

    moved = poses.touched & ~poses.fixed
    X[moved] = euler.to_se3(state[moved])
    return poses.replaced(values, X)


def _tilts(poses: PoseGraph) -> tuple[Array, Mask]:
    """Measured z, pitch and roll (n, 3) of the nodes, and which nodes (n,) have them."""
    tilt, measured = np.zeros((poses.n, 3)), np.zeros(poses.n, dtype=bool)
    for batch in poses.pattern.batches:
        if batch.kinds[0] in poses.kinds and (z := stated(batch, "tilts", Measured("z", "pitch", "roll"))) is not None:
            nodes = poses.nodes(batch.variables[0])
            tilt[nodes], measured[nodes] = z, True
    return tilt, measured


def _euler(poses: PoseGraph, X: Array, nodes: Mask) -> Array:
    """Euler 6-vectors of some nodes, named where they have none."""
    R = SE3.rotation(X[nodes])
    try:
        refuse_gimbal_lock(R)
    except SingularAt as error:
        key = poses.pattern.key(int(poses.variables[nodes][error.index]))
        message = f"dead reckoning from {key}: {error}"
        raise SingularGeometryError(message, keys=[key]) from error
    return euler.from_se3(X[nodes])
