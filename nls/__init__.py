"""Least squares on a factor graph: poses, landmarks and calibrations from measurements, each with its covariance.

A robot drives around a square, back to its first pose. The last side was measured 0.2 m too long:

    >>> import nls
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> (x,) = nls.kinds("x")  # x[3] is one pose, x[[0, 1]] are two
    >>> sides = [[1, 0, 1.57], [1, 0, 1.57], [1, 0, 1.57], [1.2, 0, 1.57]]  # m ahead, m to the left, rad turned
    >>> graph = nls.FactorGraph([Between(x[[0, 1, 2, 3]], x[[1, 2, 3, 0]], sides, Isotropic(0.1))])
    >>> start, method, chi2 = nls.initialize(graph, nls.Values({x: (SE2, SE2.identity(4))}))
    >>> result = graph.optimize(start)
    >>> print(result.values[x].round(2))  # m, m, rad
    [[ 0.    0.    0.  ]
     [ 1.    0.04  1.55]
     [ 1.02  1.08  3.1 ]
     [ 0.02  1.16 -1.59]]
    >>> print(nls.Marginals(graph, result.values).covariance(x[2], frame="world").round(3))
    [[ 0.015 -0.002 -0.004]
     [-0.002  0.012  0.004]
     [-0.004  0.004  0.008]]

Names in the order in which a program meets them:

    load                   a graph file or a mission folder: graph, values and report
    FactorGraph            measurements between variables
    Values                 a number, a point or a pose for each variable
    kinds                  kinds of variables, such as poses x and landmarks l
    factors                a package: Between, Range, Bearing and further measurements, with their noise
    initialize             the initial guess
    FactorGraph.optimize   the values of lowest chi2
    Result                 these values, chi2 and why the optimizer stopped
    Marginals              covariances of variables, alone or together
    explain                what is free, doubtful or wrong, in sentences with cures
    gnc                    the estimate without outliers
    certify                is it the global optimum? A proof in a related cost
    Incremental            the estimate after each new measurement
    plot                   pictures: trajectory, ellipses, convergence, matrices, report
    save                   a graph file

Rooms for more: `starts`, `filters`, `sonar`, `analysis`, `metrics`. Each has a ``help`` of its own. Missions of
vehicles are in `nls.missions`.

Everything is imported when it is first used, so that ``import nls`` costs nothing and a program pays for what it needs.
"""

from nls.lazy import importer, refuse_shadows

TYPE_CHECKING = False  # to a type checker always true; the import of typing takes as long as all others of a start
if TYPE_CHECKING:
    from factors.keys import Keys as Keys, Kind as Kind, kinds as kinds
    from models.errors import *  # noqa: F403  # all of them are public here
    from nls import analysis as analysis, filters as filters, metrics as metrics
    from nls import plot as plot, sonar as sonar, starts as starts
    from nls.analysis.variance_components import (
        VarianceComponents as VarianceComponents,
        variance_components as variance_components,
    )
    from nls.certificate import Certificate as Certificate, certify as certify
    from nls.covariance import Marginals as Marginals
    from nls.explanation import (
        Explanation as Explanation,
        Finding as Finding,
        FindingKind as FindingKind,
        explain as explain,
    )
    from nls.graph import FactorGraph as FactorGraph
    from nls.incremental import Incremental as Incremental
    from nls.io import LoadReport as LoadReport, load as load, save as save
    from nls.linear import (
        LU as LU,
        PCG as PCG,
        QR as QR,
        Cholesky as Cholesky,
        DenseCholesky as DenseCholesky,
        DenseQR as DenseQR,
        LinearSolver as LinearSolver,
        Pinv as Pinv,
        Schur as Schur,
        backends as backends,
        factorize as factorize,
    )
    from nls.optimizers import (
        Dogleg as Dogleg,
        Fit as Fit,
        GaussNewton as GaussNewton,
        Iteration as Iteration,
        LevenbergMarquardt as LevenbergMarquardt,
        Optimizer as Optimizer,
        Result as Result,
        Status as Status,
        Stop as Stop,
        gauss_newton_step as gauss_newton_step,
    )
    from nls.robust import Robustified as Robustified, gnc as gnc
    from nls.starts import initialize as initialize
    from nls.system import LinearSystem as LinearSystem
    from nls.values import Values as Values

__version__ = "0.1.0"

refuse_shadows()  # here and nowhere later: an error of one of their names would not say whose package it is

_WHERE = {
    "factors.keys": "Keys Kind kinds",
    "models.errors": "EvaluationError GraphError GraphFileError GraphWarning JacobianError LeadlineError "
    "MissingSolverError NoiseModelError OptionError ResourceLimitError SingularGeometryError UnderconstrainedError",
    "nls.analysis.variance_components": "VarianceComponents variance_components",
    "nls.certificate": "Certificate certify",
    "nls.covariance": "Marginals",
    "nls.explanation": "Explanation Finding FindingKind explain",
    "nls.graph": "FactorGraph",
    "nls.incremental": "Incremental",
    "nls.io": "LoadReport load save",
    "nls.linear": "LU PCG QR Cholesky DenseCholesky DenseQR LinearSolver Pinv Schur backends factorize",
    "nls.optimizers": "Dogleg Fit GaussNewton Iteration LevenbergMarquardt Optimizer Result Status Stop "
    "gauss_newton_step",
    "nls.robust": "Robustified gnc",
    "nls.starts": "initialize",
    "nls.system": "LinearSystem",
    "nls.values": "Values",
}

if not TYPE_CHECKING:
    _ROOMS = ["analysis", "filters", "metrics", "plot", "sonar", "starts"]
    __getattr__, __dir__, __all__ = importer("nls", _WHERE, *_ROOMS)
    del importer, TYPE_CHECKING  # no names for users
