r"""Data association: the landmark of each sighting, by geometry alone.

A pairing of sighting i with landmark j has the innovation nu and its covariance S = H P H' + R, and

    d2 = nu' S^-1 nu  <  chi2_m(probability)        individually compatible: within its gate

- `Nearest`: each sighting goes to the landmark of least d2 within the gate, whatever the others do,
- `Assignment`: all sightings at once, a landmark to one of them: least sum of d2, the gate for a sighting left over,
- `JointCompatibility`: the largest set of pairings whose stacked innovation is within the gate of *its* dimension, of
  several the one of least d2. Errors of the pose move all sightings together; only the stacked S knows that.

A sighting without a landmark is a new landmark where no landmark is within a second, wider gate; in between it is left
out, since a wrong pairing is never undone.

Source: J. Neira, J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17, 2001.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors.keys import Kind
from factors.replaced import replaced
from factors.sighting import Sighting
from models.abstract import Abstract
from models.algebra import Array, Index
from models.chi_squared import chi2_gate
from models.errors import GraphError, OptionError, ResourceLimitError
from models.options import check_between

NODES = 200_000  # pairings tried by `jcbb`; 25 sightings in a clutter of landmarks within each other's gates


def nearest(d2: Array, gate: float) -> Index:
    """The landmark of least distance for each sighting, -1 where none is within the gate.

    Parameters
    ----------
    d2 : (n, m) squared Mahalanobis distances of n sightings from m landmarks.
    gate : bound on d2.

    Returns
    -------
    (n,) array. Two sightings may be given one landmark.

    Examples
    --------
    >>> nearest(np.array([[4.0, 1.0], [9.0, 2.0], [30.0, 20.0]]), gate=10.0)
    array([ 1,  1, -1])
    """
    if not d2.shape[1]:
        return np.full(len(d2), -1)
    at = d2.argmin(axis=1)
    return np.where(d2[np.arange(len(d2)), at] <= gate, at, -1)


def assignment(d2: Array, gate: float) -> Index:
    """Sightings to landmarks, each at most once, of least sum of d2 where a sighting left over costs the gate.

    Parameters
    ----------
    d2 : (n, m) squared Mahalanobis distances of n sightings from m landmarks.
    gate : bound on d2.

    Returns
    -------
    (n,) array, -1 for a sighting left over.

    Notes
    -----
    Source: D. F. Crouse, "On implementing 2D rectangular assignment algorithms", 2016, as SciPy has it.

    Examples
    --------
    >>> assignment(np.array([[4.0, 1.0], [9.0, 2.0], [30.0, 20.0]]), gate=10.0)
    array([ 0,  1, -1])
    """
    from scipy.optimize import linear_sum_assignment

    n, m = d2.shape
    outside = d2 > gate
    cost = np.concatenate([np.where(outside, 2 * gate, d2), np.full((n, n), gate)], axis=1)  # n places for what is left
    _, at = linear_sum_assignment(cost)
    paired = at < m
    paired[paired] = ~outside[paired, at[paired]]
    return np.where(paired, at, -1)


def jcbb(pairs: Index, nu: Array, S: Array, n: int, probability: float) -> Index:
    """The largest set of jointly compatible pairings, of several the one of least distance: branch and bound.

    Parameters
    ----------
    pairs : (k, 2) sighting and landmark of each pairing that is individually compatible.
    nu : (k, m) innovations of the pairings.
    S : (k m, k m) covariance of all of them stacked.
    n : number of sightings.
    probability : of chi-squared with as many degrees of freedom as a set has innovations.

    Returns
    -------
    (n,) landmark of each sighting, -1 for none. No landmark is given twice.

    Raises
    ------
    ResourceLimitError
        More than 200,000 sets would have to be looked at.

    Examples
    --------
    Two landmarks 1 m apart, seen 0.9 m off by a common error: apart each sighting is nearer to the wrong one.

    >>> pairs = np.array([[0, 0], [0, 1], [1, 1]])
    >>> nu = np.array([[0.9], [-0.1], [0.9]])
    >>> S = np.ones((3, 3)) + 0.01 * np.eye(3)
    >>> jcbb(pairs, nu, S, n=2, probability=0.95)
    array([0, 1])
    """
    m = nu.shape[1] if nu.ndim == 2 else 0
    gates = [0.0, *(chi2_gate(m * (size + 1), probability) for size in range(n))] if len(pairs) else [0.0]
    single = [float(nu[k] @ np.linalg.solve(S[k * m : k * m + m, k * m : k * m + m], nu[k])) for k in range(len(pairs))]
    options = [sorted(np.flatnonzero(pairs[:, 0] == i).tolist(), key=single.__getitem__) for i in range(n)]
    left = [sum(map(bool, options[i:])) for i in range(n + 1)]  # sightings that may still be paired
    best: list[int] = []
    least, nodes = 0.0, 0

    def branch(i: int, chosen: list[int], used: frozenset[int], W: Array, y: Array, d2: float) -> None:
        """Pairings of sightings i and later, below those chosen; S_chosen = L L', W = L^-1 S[chosen], y = L^-1 nu."""
        nonlocal best, least, nodes
        nodes += 1
        if nodes > NODES:
            raise ResourceLimitError(
                f"joint compatibility: more than {NODES} sets of pairings for {n} sightings and {len(pairs)} pairings "
                "within their gates; lower the probability, or use Assignment",
                float(nodes),
                float(NODES),
                "sets of pairings",
            )
        if len(chosen) > len(best) or (len(chosen) == len(best) and d2 < least):
            best, least = chosen, d2
        if i == n or len(chosen) + left[i] < len(best) or (len(chosen) + left[i] == len(best) and d2 >= least):
            return
        for k in options[i]:
            landmark = int(pairs[k, 1])
            if landmark in used:
                continue
            at = slice(k * m, k * m + m)
            L = np.linalg.cholesky(S[at, at] - W[:, at].T @ W[:, at])
            more = np.linalg.solve(L, nu[k] - W[:, at].T @ y)
            longer = d2 + float(more @ more)
            if longer <= gates[len(chosen) + 1]:
                rows = np.linalg.solve(L, S[at] - W[:, at].T @ W)
                branch(i + 1, [*chosen, k], used | {landmark}, np.vstack([W, rows]), np.concatenate([y, more]), longer)
        branch(i + 1, chosen, used, W, y, d2)

    branch(0, [], frozenset(), np.zeros((0, len(S))), np.zeros(0), 0.0)
    landmarks = np.full(n, -1)
    for k in best:
        landmarks[pairs[k, 0]] = pairs[k, 1]
    return landmarks


@dataclass(frozen=True)
class Candidates:
    """All pairings of the sightings of a step.

    Attributes
    ----------
    d2 : (n, m) squared Mahalanobis distance of every sighting from every landmark.
    dim : numbers in a sighting.
    pairs : (k, 2) the pairings within the gate.
    nu, S : (k, dim) and (k dim, k dim) their innovations, and the covariance of all of them stacked.
    """

    d2: Array
    dim: int
    pairs: Index
    nu: Array
    S: Array


@dataclass(frozen=True)
class Association(Abstract):
    """How sightings are given to landmarks. Called with `Candidates`, it returns (n,): a landmark, or -1.

    Parameters
    ----------
    probability : with which a right pairing is within its gate.
    new : with which it is within the gate that keeps it from being a new landmark; at least `probability`.

    Raises
    ------
    OptionError
        Not such numbers.
    """

    probability: float = 0.99
    new: float = 0.9999

    def __post_init__(self) -> None:
        for name in ("probability", "new"):
            option = f"{type(self).__name__}: {name}"
            check_between(option, getattr(self, name), 0, 1, "a number between 0 and 1, such as 0.99")
        if self.new < self.probability:
            raise OptionError(f"{type(self).__name__}: new", self.new, f"at least probability, {self.probability}")

    @abstractmethod
    def __call__(self, candidates: Candidates) -> Index: ...


class Nearest(Association):
    """Each sighting to its nearest landmark, `nearest`."""

    def __call__(self, candidates: Candidates) -> Index:
        return nearest(candidates.d2, chi2_gate(candidates.dim, self.probability))


class Assignment(Association):
    """All sightings of a step at once, `assignment`."""

    def __call__(self, candidates: Candidates) -> Index:
        return assignment(candidates.d2, chi2_gate(candidates.dim, self.probability))


class JointCompatibility(Association):
    """The largest jointly compatible set of the sightings of a step, `jcbb`."""

    def __call__(self, candidates: Candidates) -> Index:
        return jcbb(candidates.pairs, candidates.nu, candidates.S, len(candidates.d2), self.probability)


class Score(NamedTuple):
    """`precision`: of the pairings made, how many are right. `recall`: of those to be made, how many were, rightly."""

    precision: float
    recall: float


def precision_recall(associations: npt.ArrayLike, true: npt.ArrayLike) -> Score:
    """How well sightings were given to landmarks, whatever numbers the landmarks were given.

    Parameters
    ----------
    associations : (n,) landmark each sighting was given to, in the order of time; -1 where it was left out.
    true : (n,) landmark each sighting is of.

    Returns
    -------
    (precision, recall). The first sighting of a found landmark makes it and says which it is; every later one is a
    pairing, right where it is of the same landmark. Pairings to be made are the sightings of landmarks made before.
    1.0 where there is nothing to be wrong about.

    Raises
    ------
    GraphError
        Different lengths.

    Examples
    --------
    Landmark 7 is found as 0; its third sighting is taken for a new landmark, a sighting of 8 for it:

    >>> precision_recall([0, 0, 1, 0], [7, 7, 7, 8])
    Score(precision=0.5, recall=0.5)
    """
    labels, truth = _labels("precision_recall", associations, true)
    paired = np.flatnonzero(labels >= 0)
    _, begin, label_of = np.unique(labels[paired], return_index=True, return_inverse=True)
    makers, later = paired[begin], np.ones(len(paired), dtype=bool)
    later[begin] = False
    right = int((truth[makers][label_of] == truth[paired])[later].sum())
    creation = np.full(len(truth), len(truth))  # when the landmark of each sighting was made
    for maker in np.sort(makers)[::-1].tolist():
        creation[truth == truth[maker]] = maker
    due = int((creation < np.arange(len(truth))).sum())
    return Score(right / int(later.sum()) if later.any() else 1.0, right / due if due else 1.0)


def pair_precision_recall(associations: npt.ArrayLike, true: npt.ArrayLike) -> Score:
    """How well sightings were grouped: of the pairs said to be of one landmark those that are, and the other way round.

    Parameters
    ----------
    associations : (n,) landmark each sighting was given to; -1 where it was left out.
    true : (n,) landmark each sighting is of; -1 of a false one, which is of none.

    Returns
    -------
    (precision, recall), 1.0 where there are no pairs.

    Raises
    ------
    GraphError
        Different lengths.

    Examples
    --------
    Three of landmark 7, one of them left out, and a false sighting given to it:

    >>> pair_precision_recall([0, 0, -1, 0], [7, 7, 7, -1])
    Score(precision=0.3333333333333333, recall=0.3333333333333333)
    """
    labels, truth = _labels("pair_precision_recall", associations, true)
    both = (labels >= 0) & (truth >= 0)
    right = _pairs(np.column_stack([labels, truth])[both])
    joined, due = _pairs(labels[labels >= 0]), _pairs(truth[truth >= 0])
    return Score(right / joined if joined else 1.0, right / due if due else 1.0)


def _labels(function: str, associations: npt.ArrayLike, true: npt.ArrayLike) -> tuple[Index, Index]:
    """Landmarks (n,) as said and as they are."""
    labels, truth = np.asarray(associations), np.asarray(true)
    if labels.shape != truth.shape or labels.ndim != 1:
        raise GraphError(f"{function}: shapes {labels.shape} and {truth.shape}, expected (n,) twice")
    return labels, truth


def _pairs(groups: npt.NDArray[np.integer]) -> int:
    """Pairs of rows that are equal."""
    count = np.unique(groups, axis=0, return_counts=True)[1]
    return int((count * (count - 1) // 2).sum())


def identified(sightings: Sighting, associations: npt.ArrayLike, kind: Kind) -> Sighting:
    """Sightings with the landmarks they were given to, those left out left out: for a graph of the same data.

    Parameters
    ----------
    sightings : whatever landmarks its measurements name.
    associations : (n,) numbers of landmarks in the order of time, as `EKF.associations`. Those of one pose are in the
        order of the factor. -1 for a sighting that was left out.
    kind : of the landmarks.

    Raises
    ------
    GraphError
        Another number of sightings.

    Examples
    --------
    >>> from factors import Isotropic, Landmark
    >>> from nls import kinds
    >>> x, l = kinds("x", "l")
    >>> seen = Landmark(x[[1, 0, 1]], l[[0, 1, 2]], [[1, 0], [2, 0], [3, 0]], Isotropic(0.1))
    >>> identified(seen, [5, -1, 6], l), identified(seen, [5, -1, 6], l).z.tolist()
    (Landmark(x[0, 1], l[5, 6]), [[2.0, 0.0], [3.0, 0.0]])
    """
    numbers = np.asarray(associations)
    if numbers.shape != (len(sightings),):
        raise GraphError(f"{sightings.name}: {numbers.shape} landmarks found for {len(sightings)} sightings")
    of = np.empty_like(numbers)
    of[np.argsort(sightings.keys[0].numbers, kind="stable")] = numbers
    chosen = sightings[of >= 0]
    associated = replaced(chosen, [chosen.keys[0], kind[of[of >= 0]], *chosen.keys[2:]])
    assert isinstance(associated, Sighting)
    return associated
