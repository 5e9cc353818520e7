"""Certified, refuted or undecided: the verdict on the values of a solved pose graph, in words and numbers."""

import warnings
from dataclasses import dataclass, field, replace

import numpy as np

from models.advice import Advice, listed
from models.algebra import Array
from models.errors import GraphWarning, UnderconstrainedError
from nls.certificate.optimum import BOUND, Optimum, Spectrum, negligible, newton, placed, spectrum, staircase
from nls.certificate.problem import Problem, certifiable
from nls.graph import FactorGraph
from nls.optimizers import Result, Stop, default_optimizer
from nls.sparse.threads import single_thread
from nls.starts.chordal import chordal
from nls.values import Values, refuse_other

WORST = "the measurements with the largest errors: remove wrong ones, then a proof may be possible"
CHI2_RTOL, POSES_TOL = 1e-6, 1e-6  # relative fall of chi2 that is none; poses that are the same (meters, radians)
LEFT_BY_STOP = 10.0  # times CHI2_RTOL: what two ends of an optimization may differ by, see `Stop`


@dataclass(frozen=True)
class Certificate:
    """Verdict on the values of a pose graph, by a proof in the SE-Sync cost; ``report()`` says it in words.

    The proof is about `values`, the lowest minimum of the SE-Sync cost that was found. The verdict is about the values
    given: chi2 is optimized from that minimum, and either ends at them or not.

    Attributes
    ----------
    verdict : ``certified``: `values` are proved to be the global optimum of the SE-Sync cost, and chi2 optimized from
        there ends at the values given, within 1. ``refuted``: it ends lower, elsewhere. ``undecided``: neither; the
        proof is missing, chi2 ends higher, or the stop of the values given left more than 1 of chi2.
    chi2_given : of the values given.
    chi2_reached : where chi2 ends, optimized from `values`.
    reached : whether that optimization converged.
    better : the values where it ends; None unless they have a lower chi2 than those given. Where they are at the same
        minimum, by more than 1.
    cost_given : SE-Sync cost of the values given.
    cost, values : the lowest minimum of the SE-Sync cost that was found, and its cost. The pose of lowest number, or
        the one that is fixed or has a prior, keeps its place.
    proved : whether `values` are the global optimum of the SE-Sync cost: `lowest` is `cost` but for a millionth, or
        for what rounding hides, a hundredth at most; and never for more than 1.
    lowest : no pose graph has a lower SE-Sync cost.
    eigenvalues : (d + 1,) the smallest ones of the certificate matrix at `values`, positions eliminated. Where proved,
        d of them are 0 but for rounding; the next one, above 0, says that there is no other optimum but for a
        motion of the whole.
    direction : (n, d + 1) the eigenvector of the first eigenvalue, in the order of the values. Its rows below every [R
        t] lower the SE-Sync cost. None where proved.
    moved : largest distance, m, and angle, rad, between the values given and `values`, pose by pose.
    moved_rms : their root mean squares.
    converged, steps : whether Newton's method had nothing left to gain at `values`, and its steps.
    """

    verdict: str
    chi2_given: float
    chi2_reached: float
    reached: bool
    better: Values | None = field(repr=False)
    cost_given: float
    cost: float
    values: Values = field(repr=False)
    proved: bool
    lowest: float
    eigenvalues: Array
    direction: Array | None = field(repr=False)
    moved: tuple[float, float]
    moved_rms: tuple[float, float]
    converged: bool
    steps: int

    @property
    def eigenvalue(self) -> float:
        """The smallest one."""
        return float(self.eigenvalues[0])

    @property
    def lower_chi2(self) -> float | None:
        """chi2 of `better`; None where there is none."""
        return None if self.better is None else self.chi2_reached

    @property
    def advice(self) -> tuple[Advice, ...]:
        """A cure where a lower chi2 was found; measurements to inspect where only the proof is missing."""
        if self.better is not None:
            return (Advice("start at better"),)
        return () if self.proved else (Advice("inspect", (WORST,)),)

    @property
    def sentence(self) -> str:
        """The verdict and its reason."""
        minimum = "global optimum of the SE-Sync cost" if self.proved else "lowest minimum of the SE-Sync cost found"
        ends, higher = f"chi2, optimized from the {minimum},", "ends higher" if self.reached else "does not converge"
        if self.verdict == "certified":
            why = f"{ends} ends at this solution. The proof is in that cost, not in chi2. This "
            why += "does not validate the measurements"
        elif self.verdict == "refuted":
            why = f"not globally optimal: {ends} ends lower"
        elif self.better is not None:
            fall = self.chi2_given - self.chi2_reached
            why = f"this solution stopped too early: chi2 falls to its minimum by {fall:.3g}, more than {BOUND:g}"
        elif self.proved:
            why = f"no lower chi2 was found, and {ends} {higher}"
        else:
            why = "no lower chi2 was found, and no minimum of the SE-Sync cost was proved to be its global optimum: "
            why += f"that may be {self.cost - self.lowest:.3g} lower, more than {negligible(self.cost):.3g}"
        return f"{self.verdict}: {why}"

    def report(self, shell: bool = False) -> str:
        """The verdict, chi2, the SE-Sync minimum and its distance, the eigenvalues: five lines. One more, the way on
        for Python or for the command line, where there is one."""
        (distance, angle), (distance_rms, angle_rms) = self.moved, self.moved_rms
        lines = [
            self.sentence,
            f"chi2: {self.chi2_given:.9g} at this solution, {self.chi2_reached:.9g} optimized from that minimum",
            f"SE-Sync cost: {self.cost_given:.6g} at this solution, {self.cost:.6g} at that minimum, "
            f"{self.cost - self.lowest:.1g} above the lowest possible one at most",
            f"that minimum is {distance_rms:.3g} m and {np.degrees(angle_rms):.3g} deg rms from this solution, "
            f"{distance:.3g} m and {np.degrees(angle):.3g} deg at most",
            f"smallest eigenvalues of its certificate matrix: {', '.join(f'{e:.3g}' for e in self.eigenvalues)}",
        ]
        return "\n".join([*lines, *(f"  -> {words}" for words in listed(self.advice, shell))])


@single_thread()
def certify(graph: FactorGraph, values: Values, stop: Stop | None = None) -> Certificate:
    r"""Whether chi2 ends at these values from the global optimum of the SE-Sync cost, which is proved if possible.

    .. math:: \sum_{(i,j)} \kappa |R_j - R_i R_{ij}|_F^2 + \tau |t_j - t_i - R_i t_{ij}|^2

    with :math:`\tau = d / \mathrm{tr}(\Omega_t^{-1})` and :math:`\kappa = \Omega_{33}` in the plane,
    :math:`\kappa = 3 / (2\,\mathrm{tr}(\Omega_R^{-1}))` in space, of the blocks of each measurement's information in
    the chart of its convention (of a g2o file: its numbers).

    Parameters
    ----------
    graph : `Between` factors of SE2, or of SE3, that connect all poses; nothing else but a `Prior` on one pose.
    values : a solution, such as ``graph.optimize(...).values``.
    stop : thresholds by which the values were found, where they are looser than those of `Stop`.

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
    UnderconstrainedError
        chi2 cannot be optimized from the minimum of the SE-Sync cost.

    Notes
    -----
    The global optimum of chi2 is another one, near that of the SE-Sync cost where residuals are small. So chi2 is
    optimized from there, until a step brings less than 0.1. It ends at the values given if it has the same chi2 within
    a part of 1e-5, that much two ends of an optimization may differ by, and within 1. Where 1e-5 of chi2 is
    wider than 1, chi2 is optimized from the values given, too, and has to end there. chi2 of exact measurements is
    rounding; then the poses have to agree within 1e-6. D. Rosen, L. Carlone, A. Bandeira, J. Leonard, "SE-Sync:
    a certifiably correct algorithm for synchronization over the special Euclidean group", IJRR 38(2-3), 2019.

    Where there is a `better`, ``graph.optimize(certificate.better)`` goes on; certify its values in turn.

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
    optimum, known = _lowest(problem, graph, values, newton(problem, M_given))
    distance, angle = _apart(M_given, optimum.M)
    minimum, chi2_given = problem.graph.replaced(values, problem.poses(optimum.M)), graph.chi2(values)
    end = _optimized(graph, minimum)
    same = _same(problem, graph, values, end, stop or Stop())
    lower = chi2_given - end.chi2_final > BOUND * same
    sure = same and not lower and known.certified and end.converged
    return Certificate(
        verdict="certified" if sure else "refuted" if lower and not same else "undecided",
        chi2_given=chi2_given,
        chi2_reached=end.chi2_final,
        reached=end.converged,
        better=end.values if lower else None,
        cost_given=problem.cost(M_given),
        cost=optimum.cost,
        values=minimum,
        proved=known.certified,
        lowest=known.lowest,
        eigenvalues=known.eigenvalues,
        direction=None if known.certified else known.v,
        moved=(float(distance.max()), float(angle.max())),
        moved_rms=(float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean(angle**2)))),
        converged=optimum.converged,
        steps=optimum.steps,
    )


def _same(problem: Problem, graph: FactorGraph, values: Values, end: Result, stop: Stop) -> bool:
    """Whether values are at the minimum where an optimization ended, within their stop.

    Where that leaves more than chi2 may differ, chi2 optimized from the values has to end there.
    """
    if _agree(problem, graph, values, end):
        return True
    given = graph.chi2(values)
    is_loose = abs(given - end.chi2_final) <= LEFT_BY_STOP * max(CHI2_RTOL * given, stop.sigmas(given, end.dof) ** 2)
    return is_loose and _agree(problem, graph, _optimized(graph, values).values, end)


def _agree(problem: Problem, graph: FactorGraph, values: Values, end: Result) -> bool:
    """Whether values have the chi2 at which an optimization ended."""
    given = graph.chi2(values)
    gap = abs(given - end.chi2_final)
    if gap > BOUND or gap <= LEFT_BY_STOP * CHI2_RTOL * given:
        return gap <= BOUND
    M, M_end = (problem.matrices(problem.graph.stack(at)) for at in (values, end.values))
    apart = np.max(_apart(M, placed(M_end, M, problem.held)))
    return bool(apart <= POSES_TOL and gap <= LEFT_BY_STOP * CHI2_RTOL * len(problem.W))  # exact measurements


def _optimized(graph: FactorGraph, values: Values) -> Result:
    """The optimum of chi2 from values."""
    # a step that brings less of chi2 than 0.1 is the last one, however high chi2 is
    stop = Stop(chi2_rtol=min(CHI2_RTOL, BOUND / LEFT_BY_STOP / max(graph.chi2(values), BOUND)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GraphWarning)  # they were given when it was solved
        return graph.optimize(values, default_optimizer(graph.factors, stop))


def _lowest(problem: Problem, graph: FactorGraph, values: Values, optimum: Optimum) -> tuple[Optimum, Spectrum]:
    """The lowest minimum of the SE-Sync cost, as given, from a chordal start or up the staircase; its spectrum.

    What the staircase knows that nothing is below can prove it, too.
    """
    known = spectrum(problem, optimum)
    if not known.certified:
        start = _from_chordal(problem, graph, values, optimum)
        if start is not None and start.cost < optimum.cost - negligible(optimum.cost):
            optimum, known = start, spectrum(problem, start)
    if not known.certified:
        start, lowest = staircase(problem, optimum, known)
        if start is not None and start.cost < optimum.cost - negligible(optimum.cost):
            optimum, known = start, spectrum(problem, start)
        lowest, gap = max(lowest, known.lowest), negligible(optimum.cost)
        known = replace(known, lowest=lowest, certified=known.certified or optimum.cost - lowest <= gap)
    return optimum, known


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
