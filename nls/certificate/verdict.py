"""Certified, refuted or undecided: the verdict on a solved pose graph, in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from models.advice import Advice, listed
from models.algebra import Array
from models.errors import UnderconstrainedError
from nls.certificate.newton import Optimum, newton
from nls.certificate.problem import Problem, certifiable
from nls.certificate.spectrum import RELATIVE, Spectrum, spectrum
from nls.certificate.staircase import placed, staircase
from nls.graph import FactorGraph
from nls.sparse.threads import single_thread
from nls.starts.chordal import chordal
from nls.values import Values, refuse_other

__all__ = ["Certificate", "certify"]


@dataclass(frozen=True)
class Certificate:
    """Certificate of the global optimum of a pose graph in the SE-Sync cost; ``report()`` says it in words.

    Attributes
    ----------
    verdict : ``certified``: no pose graph costs less than `lowest`, and that is `cost` but for a millionth, or
        for what rounding hides, a hundredth at most; ``refuted``: `better` costs less; ``undecided``: neither is shown.
    cost : of `values`, the local minimum next to the values given.
    cost_given : of the values given.
    lowest : no pose graph costs less.
    eigenvalues : (d + 1,) the smallest ones of the certificate matrix, positions eliminated. At a certified optimum d
        of them are 0; the next one, above 0, says that there is no other one but for a motion of the whole.
    values : the values given with the poses of the local minimum; the pose of lowest number, or the one that is fixed
        or has a prior, keeps its place.
    better, better_cost : a minimum of lower cost, where one was found, with the same pose in its place.
    direction : (n, d + 1) the eigenvector of the first eigenvalue, in the order of the values. Its rows below every [R
        t] lower the cost. None where certified.
    moved : largest distance, m, and angle, rad, between the values given and `values`, pose by pose.
    moved_rms : their root mean squares.
    lower_chi2 : chi2 of the graph at `better`, or else at `values`, where it is below that of the values given. These
        then are not the global optimum of chi2 either. None otherwise.
    converged, steps : whether Newton's method had nothing left to gain at `values`, and its steps.
    """

    verdict: str
    cost: float
    cost_given: float
    lowest: float
    eigenvalues: Array
    values: Values = field(repr=False)
    better: Values | None = field(repr=False)
    better_cost: float | None
    direction: Array | None = field(repr=False)
    moved: tuple[float, float]
    moved_rms: tuple[float, float]
    lower_chi2: float | None
    converged: bool
    steps: int

    @property
    def eigenvalue(self) -> float:
        """The smallest one."""
        return float(self.eigenvalues[0])

    @property
    def advice(self) -> tuple[Advice, ...]:
        """Cures where the solution is not the lowest."""
        return () if self.lower_chi2 is None else (Advice("start at better"),)

    def report(self, shell: bool = False) -> str:
        """The verdict, its minimum and the distance of the given values, and the eigenvalues: four lines. Two more
        where `lower_chi2` is known, with the advice for Python or for the command line."""
        sentences = {
            "certified": "globally optimal in the SE-Sync cost, which differs slightly from chi2. This does not "
            "validate the measurements",
            "refuted": "not globally optimal: other poses have a lower SE-Sync cost",
            "undecided": "no poses with a lower SE-Sync cost were found, and global optimality was not proved",
        }
        known = {
            "certified": f"the lowest possible one is at most {self.cost - self.lowest:.1g} below",
            "refuted": f"a lower one is {self.better_cost or 0.0:.6g}",
            "undecided": f"the lowest possible one is at least {self.lowest:.6g}",
        }
        (distance, angle), (distance_rms, angle_rms) = self.moved, self.moved_rms
        lines = [
            f"{self.verdict}: {sentences[self.verdict]}",
            f"SE-Sync cost: {self.cost:.6g} at the minimum beside this solution, {known[self.verdict]}",
            f"the solution has {self.cost_given:.6g} and is {distance_rms:.3g} m and {np.degrees(angle_rms):.3g} deg "
            f"rms from that minimum, {distance:.3g} m and {np.degrees(angle):.3g} deg at most",
            f"smallest eigenvalues of the certificate matrix: {', '.join(f'{e:.3g}' for e in self.eigenvalues)}",
        ]
        if self.lower_chi2 is not None:
            lines.append(f"chi2 of the solution is not the lowest: {self.lower_chi2:.6g} is lower")
            lines += [f"  -> {words}" for words in listed(self.advice, shell)]
        return "\n".join(lines)


@single_thread()
def certify(graph: FactorGraph, values: Values) -> Certificate:
    r"""Global optimality of a pose graph, in the cost in which it can be certified.

    .. math:: \sum_{(i,j)} \kappa |R_j - R_i R_{ij}|_F^2 + \tau |t_j - t_i - R_i t_{ij}|^2

    with :math:`\tau = d / \mathrm{tr}(\Omega_t^{-1})` and :math:`\kappa = \Omega_{33}` in the plane,
    :math:`\kappa = 3 / (2\,\mathrm{tr}(\Omega_R^{-1}))` in space, of the blocks of each measurement's information in
    the chart of its convention (of a g2o file: its numbers).

    Parameters
    ----------
    graph : `Between` factors of SE2, or of SE3, that connect all poses; nothing else but a `Prior` on one pose.
    values : a solution, such as ``graph.optimize(...).values``. From there the cost is minimized first.

    Returns
    -------
    Certificate

    Raises
    ------
    GraphError
        Anything else in the graph: other measurements, robust kernels, several parts, spaces or held poses; information
        that has no inverse.
    EvaluationError
        Weights that overflow, or of positions that differ by more than the digits of numbers hold.

    Notes
    -----
    chi2 has another optimum, near this one where residuals are small. A certificate holds for chi2 only if the two
    minima lie in one valley, and `Certificate.moved` says how far they are apart. D. Rosen, L. Carlone, A. Bandeira, J.
    Leonard, "SE-Sync: a certifiably correct algorithm for synchronization over the special Euclidean group", IJRR
    38(2-3), 2019.

    Examples
    --------
    >>> import numpy as np
    >>> import nls
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> (x,) = nls.kinds("x")
    >>> square = Between(x[[0, 1, 2, 3]], x[[1, 2, 3, 0]], [1.0, 0.0, 1.5], Isotropic(0.1))
    >>> graph = nls.FactorGraph([square])
    >>> start, *_ = nls.initialize(graph, nls.Values({x: (SE2, SE2.identity(4))}))
    >>> certificate = nls.certify(graph, graph.optimize(start).values)
    >>> certificate.verdict, round(certificate.cost, 4), bool(certificate.eigenvalues[2] > 1)
    ('certified', 4.008, True)
    """
    refuse_other("certify", graph, values)
    problem = certifiable(graph, values)
    M_given = problem.matrices(problem.graph.stack(values))
    optimum = newton(problem, M_given)
    known = spectrum(problem, optimum)
    better, lowest = (None, known.lowest) if known.certified else _better(problem, graph, values, optimum, known)
    distance, angle = _apart(M_given, optimum.M)
    minimum, best = (problem.graph.replaced(values, problem.poses(at.M)) for at in (optimum, better or optimum))
    chi2, chi2_given = graph.chi2(best), graph.chi2(values)
    return Certificate(
        verdict="certified" if known.certified else "undecided" if better is None else "refuted",
        cost=optimum.cost,
        cost_given=problem.cost(M_given),
        lowest=lowest,
        eigenvalues=known.eigenvalues,
        values=minimum,
        better=None if better is None else best,
        better_cost=None if better is None else better.cost,
        direction=None if known.certified else known.v,
        moved=(float(distance.max()), float(angle.max())),
        moved_rms=(float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean(angle**2)))),
        lower_chi2=chi2 if chi2 < (1 - RELATIVE) * chi2_given - problem.rounding(M_given) else None,
        converged=optimum.converged,
        steps=optimum.steps,
    )


def _better(
    problem: Problem, graph: FactorGraph, values: Values, optimum: Optimum, known: Spectrum
) -> tuple[Optimum | None, float]:
    """A lower minimum, from the chordal start or else up the staircase, and what no pose graph costs less than."""
    limit, lowest = (1 - RELATIVE) * optimum.cost, known.lowest
    better = _from_chordal(problem, graph, values, optimum)
    if better is None or better.cost >= limit:
        better, lowest = staircase(problem, optimum, known)
    if better is None or better.cost >= limit:
        return None, lowest
    return better, max(spectrum(problem, better).lowest, lowest)


def _from_chordal(problem: Problem, graph: FactorGraph, values: Values, optimum: Optimum) -> Optimum | None:
    try:
        X = problem.graph.stack(chordal(graph, values))
    except UnderconstrainedError:  # rotations that cancel: there is no such start
        return None
    return newton(problem, placed(problem.matrices(X), optimum.M, problem.held))


def _apart(A: Array, B: Array) -> tuple[Array, Array]:
    """Distances (n,), m, and angles (n,), rad, of two pose graphs."""
    difference = A - B
    chord = np.linalg.norm(difference[:, :-1], axis=(1, 2))  # 2 sqrt(2) sin(angle / 2)
    half = np.minimum(chord / np.sqrt(8), 1.0)  # rounding can take a half turn beyond 1
    return np.linalg.norm(difference[:, -1], axis=1), 2 * np.arcsin(half)
