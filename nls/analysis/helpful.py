r"""Which motion would help: one more view, for one motion of the vehicle after another.

The last pose X is copied to X' = X o F o Exp(m) o F^-1, m the motion along and about the axes of a frame F on the
vehicle, with all that was measured from X: the same targets, the same noise, without error. X' is unknown like every
other pose. The standard deviations of the variable before and after say what the view is worth.

A measurement that joins X with the pose before it is a leg: the copy joins X' with X.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.keys import Keys
from factors.replaced import predicted
from models import LieGroup
from models.algebra import Array, Mask
from models.errors import GraphError, OptionError
from nls.analysis.observable import Observability, columns, in_unit
from nls.analysis.variable import check_one, observability
from nls.graph import FactorGraph
from nls.values import Values

MOTION_NAMES = {"x": "surge", "y": "sway", "z": "heave", "roll": "roll", "pitch": "pitch", "yaw": "yaw"}


@dataclass(frozen=True)
class Motion:
    """One motion, and the covariance of the variable after a view from there.

    Attributes
    ----------
    name : ``"pitch 10 deg"``.
    motion : (size,) element of the group of the pose.
    after : as `observability` tells.
    gain : (d,) sigma before / sigma after, at least 1: 1 where it stays undetermined, inf where it becomes determined.
    """

    name: str
    motion: Array
    after: Observability
    gain: Array


@dataclass(frozen=True)
class Motions:
    """Motions, the most helpful first. ``print`` it.

    Attributes
    ----------
    pose : from where.
    before : what is known without.
    ranking : the motions; the one named ``stay`` is a second look from the same place, for comparison.
    """

    pose: Keys
    before: Observability
    ranking: tuple[Motion, ...]

    def __str__(self) -> str:
        names = self.before.components
        rows = [["", *names], *([m.name, *_cells(m)] for m in self.ranking)]
        head = (
            f"one more view from {self.pose!r}: sigmas of {self.before.key!r}, before / after; weakest before: "
            f"{names[self.before.weakest]}"
        )
        return "\n".join([head, *columns(rows)])


def _cells(motion: Motion) -> list[str]:
    """The gain of every component; where it has become determined, its sigma."""
    after = motion.after
    return [
        f"now {in_unit(sigma, unit)}" if np.isinf(gain) else "free" if np.isinf(sigma) else f"{gain:.3f}"
        for unit, gain, sigma in zip(after.units, motion.gain, after.sigma, strict=True)
    ]


def helpful_motions(
    graph: FactorGraph,
    values: Values,
    key: Keys,
    pose: Keys | None = None,
    motions: Mapping[str, npt.ArrayLike] | None = None,
    frame: npt.ArrayLike | None = None,
) -> Motions:
    """Motions of the vehicle by how much one view more, after the motion, would tell about a variable.

    Parameters
    ----------
    graph, values, key : as for `observability`.
    pose : from where; of the poses that share a factor with the variable the one of highest number, when omitted.
    motions : (dim,) tangent steps by name; 0.5 m along and 10 deg about every axis when omitted.
    frame : (size,) pose, on the vehicle, of the frame whose axes these are: x forward, y to starboard, z down for the
        names surge, sway, heave. The frame of the pose when omitted.

    Returns
    -------
    Motions
        First those that leave fewest directions free, then by the sigma of the weakest component before, or of the
        weakest of the free ones.

    Raises
    ------
    GraphError
        More than one variable; no pose shares a factor with it; a factor from a function, of which no part can be
        taken; one whose target is no variable, such as `EpipolarArc`, so that nothing says where it is.
    OptionError
        A motion that is no step.
    SingularGeometryError
        A target would be behind the camera, or at the sensor.

    Notes
    -----
    Nothing is known here of what hides a target: fans, images and obstacles are yours to think of. Give small motions.
    Limits (`Factor.limit_only`) are no measurements and are not copied.

    Examples
    --------
    A sonar that has only moved ahead, and the point it looks at: its depth wants a heave or a roll.

    >>> import numpy as np
    >>> from factors import Between, Diagonal, Isotropic, RangeAzimuth
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> values = Values({x: (SE3, np.array([[0, 0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0, 1]])), l: (R(3), [4, 1, 0])})
    >>> contacts = RangeAzimuth(x[[0, 1]], l[[0, 0]], [[4.123, 0.245], [3.162, 0.322]], Diagonal([0.01, 0.005]))
    >>> graph = FactorGraph([contacts])
    >>> graph.fix(x[[0, 1]])
    >>> odometry = graph.add(Between(x[0], x[1], [1, 0, 0, 0, 0, 0, 1], Isotropic(0.01)))
    >>> print(helpful_motions(graph, values, l[0]))
    one more view from x1: sigmas of l0, before / after; weakest before: z
                        x      y            z
      heave 0.5 m   1.012  1.053  now 0.101 m
      roll 10 deg   1.083  1.006  now 0.235 m
      pitch 10 deg  1.083  1.006  now 0.696 m
      stay          1.098  1.061         free
      surge 0.5 m   1.095  1.084         free
      sway 0.5 m    1.121  1.060         free
      yaw 10 deg    1.098  1.061         free
    """
    check_one("helpful_motions", key)
    pose = _last(graph, values, key) if pose is None else pose
    group = values.stack(pose.kind).manifold if isinstance(pose, Keys) and len(pose) == 1 else None
    if not isinstance(group, LieGroup) or not group.body_axes:
        raise GraphError(f"helpful_motions: expected one pose such as x[0], got {pose!r:.60}")
    F = group.identity()[0] if frame is None else group.stack(frame)[0]
    before = observability(graph, values, key)
    outcomes = []
    for name, step in (_simple(group) if motions is None else dict(motions)).items():
        step = _step(name, step, group)
        motion = group.compose(group.compose(F, group.exp(step)), group.inverse(F))
        after = observability(*_seen_again(graph, values, pose, motion), key, before.length)
        with np.errstate(invalid="ignore"):
            gain = np.where(after.undetermined, 1.0, before.sigma / after.sigma)
        outcomes.append(Motion(name, motion, after, gain))
    weak = before.undetermined if before.undetermined.any() else np.arange(len(before.sigma)) == before.weakest
    outcomes.sort(key=lambda m: (-m.after.rank, float((m.after.sigma * m.after.weights)[weak].max())))
    return Motions(pose, before, tuple(outcomes))


def _step(name: str, step: npt.ArrayLike, group: LieGroup) -> Array:
    """A tangent step (dim,)."""
    try:
        vector = np.asarray(step, dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (group.dim,) or not np.isfinite(vector).all():
        raise OptionError(f"motions: {name}", step, f"a step of {group.dim} finite numbers, {group.components}")
    return vector


def _simple(group: LieGroup) -> dict[str, Array]:
    """0.5 m along and 10 deg about every axis, and not to move at all."""
    turn = np.radians(10.0)
    steps = {"stay": np.zeros(group.dim)}
    for step, name in zip(np.eye(group.dim), group.components, strict=True):
        amount, label = (0.5, "0.5 m") if name in ("x", "y", "z") else (turn, "10 deg")
        steps[f"{MOTION_NAMES[name]} {label}"] = amount * step
    return steps


def _last(graph: FactorGraph, values: Values, key: Keys) -> Keys:
    """The pose of highest number that shares a factor with a variable."""
    shared: dict[str, int] = {}
    for factor in graph.factors:
        mask = _touching(factor, key)
        for keys in factor.keys:
            if keys.kind != key.kind and mask.any() and values.stack(keys.kind).manifold.body_axes:
                shared[keys.kind] = max(shared.get(keys.kind, -1), int(keys.numbers[mask].max()))
    if not shared:
        message = f"no pose shares a factor with {key!r}; say which one moves, pose=x[0]"
        raise GraphError(f"helpful_motions: {message}", [key])
    kind = next(iter(shared))
    return Keys(kind, shared[kind])


def _touching(factor: Factor, key: Keys) -> Mask:
    """Which measurements (n,) have a variable."""
    slots = [keys.numbers == key.numbers[0] for keys in factor.keys if keys.kind == key.kind]
    return np.any(slots, axis=0) if slots else np.zeros(len(factor), dtype=bool)


def _seen_again(graph: FactorGraph, values: Values, pose: Keys, motion: Array) -> tuple[FactorGraph, Values]:
    """The graph and its values with one more pose, and with what would be measured from there."""
    stack = values.stack(pose.kind)
    new = int(stack.numbers.max()) + 1
    group = stack.manifold
    assert isinstance(group, LieGroup)
    new_pose = group.compose(values[pose].reshape(1, -1), motion)
    moved_values = values.extended(Keys(pose.kind, new), new_pose)

    views = []
    for factor in graph.factors:
        mine = np.zeros(0) if factor.limit_only else _touching(factor, pose)
        if mine.any():
            views.append(factor if mine.all() else factor[mine])
    last = int(pose.numbers[0])
    joined = np.concatenate([k.numbers for view in views for k in view.keys if k.kind == pose.kind])
    before = joined[joined < last].max(initial=-1)
    extended = FactorGraph(graph.factors, graph.fixed)
    for view in views:
        keys = [
            Keys(k.kind, np.where(k.numbers == last, new, np.where(k.numbers == before, last, k.numbers)))
            if k.kind == pose.kind
            else k
            for k in view.keys
        ]
        extended.add(predicted(view, keys, moved_values))
    return extended, moved_values
