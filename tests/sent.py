"""One object of every class that a user saves or sends to another process, and their contents as plain tuples."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import factors
import nls
import sim
from factors import Factor, Isotropic
from models import LINE, S2, SE2, SE3, SO2, SO3, Measured, R, errors
from models.sensors import DIDSON_HIGH, HOLOOCEAN_DVL, Camera, SingularAt
from nls import filters
from nls.analysis import Unverified, helpful_motions, landmark_information, observability
from nls.covariance import Marginals
from nls.linear.dense import Small
from nls.linear.factorization import SingularSystemError, UnsolvedSystemError
from nls.metrics import ate
from nls.robust import kernels
from tests.sim.scenes import thinned


def contents(thing: Any, met: dict[int, tuple[int, Any]] | None = None) -> Any:
    """The numbers and names an object is made of, without its identity: equal for an object and its copy."""
    met = {} if met is None else met
    if thing is None or isinstance(thing, str | bytes | int | float | complex | slice):
        return repr(thing)
    if hasattr(thing, "__qualname__"):  # a class or function
        return f"{thing.__module__}.{thing.__qualname__}"
    if id(thing) in met:
        return met[id(thing)][0]
    met[id(thing)] = len(met), thing
    if isinstance(thing, np.ndarray):
        return thing.dtype.str, thing.shape, thing.tobytes()
    if isinstance(thing, dict):
        return tuple((contents(key, met), contents(value, met)) for key, value in thing.items())
    if isinstance(thing, list | tuple):
        return tuple(contents(item, met) for item in thing)
    if isinstance(thing, BaseException):  # whose reduction depends on whether somebody has looked at its attributes
        return contents((type(thing), thing.args, vars(thing)), met)
    return contents(thing.__reduce_ex__(4), met)


def received(connection: Any) -> None:
    """In another process: the contents of what was sent, and the things themselves."""
    with connection:
        things = connection.recv()
        connection.send(({name: contents(thing) for name, thing in things.items()}, things))


def distance(sigma: float, X: np.ndarray) -> np.ndarray:
    """A residual at the top of a module: of points X (n, 2), from a circle of 1 m."""
    return (np.linalg.norm(X, axis=1, keepdims=True) - 1) / sigma


def things(folder: Path) -> dict[str, Any]:
    """By name; `folder` takes a graph file and a mission."""
    x, l, s = nls.kinds("x", "l", "s")
    rng = np.random.default_rng(1)
    ring = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    sea = sim.subsea(rng, laps=1, known_start=True)
    short = thinned(sea)
    lines, rig = sim.lines(rng), sim.rig(rng, poses=4, points=20)
    mission = sim.hauv_floor(rng, legs=2, per_leg=6)
    result = ring.graph.optimize(ring.start)
    nls.save(folder / "ring.g2o", ring.graph, ring.start)
    seen = nls.Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [3, 0, 0]]), l: (R(2), [[5, 4]]), s: (SE2, [0.5, 0.2, 0])})
    ranges = factors.Range(x[0:3], l[[0, 0, 0]], [5.9, 5.2, 4.1], Isotropic(0.1), offset=s[0])
    fixed = nls.FactorGraph([ranges], [x[0:3], l[0]])
    pings = nls.FactorGraph([factors.Range(x[0:2], l[[0, 0]], [5.9, 5.2], Isotropic(0.1))], [x[0:2]])
    system = result_system(ring.graph, result.values)
    solvers: list[Callable[[], nls.LinearSolver]] = [
        nls.Cholesky, nls.DenseCholesky, nls.DenseQR, nls.LU, nls.PCG, nls.Pinv, nls.QR, nls.Schur,
        Small,
    ]  # fmt: skip
    smoother = nls.Incremental()
    smoother.update(list(ring.graph.factors), nls.Values({x: (SE2, ring.start[x[:1]])}))
    made: dict[str, Any] = {
        "manifolds": [SO2, SE2, SO3, SE3, LINE, S2, R(1), R(2), R(7), Measured("range", "azimuth"), Measured("depth")],
        "names": [x, l, x[3], x[[1, 2, 9]], x[0:0], x[[7]]],
        "values": sea.start,
        "smoother": smoother,
        "noises": [
            Isotropic([0.1, 0.2]),
            factors.Diagonal(x=0.1, yaw=0.2),
            factors.Covariance(np.eye(2)),
            factors.Information(np.eye(2)),
            factors.SqrtInformation(np.eye(2)),
            factors.Robust(Isotropic(2.0), factors.DCS(3.0)),
        ],
        "kernels": [kind(1.5) for kind in factors.robust.KERNELS.values()],
        "graduated kernels": [kind(1.5) for kind in kernels.LOSSES.values()],
        "factor of a function": Factor.from_function(partial(distance, 0.1), x[0:3], 1),
        "graphs": [ring.graph, sea.graph, fixed],
        "system": system,
        "result": result,
        "marginals": Marginals(sea.graph, sea.truth),
        "marginals of few variables": Marginals(ring.graph, result.values),
        "marginals, free gauge": Marginals(ring.graph, result.values, gauge="free"),
        "marginals by LU": Marginals(ring.graph, result.values, nls.LU()),
        "marginals by Schur": Marginals(sea.graph, sea.truth, nls.Schur()),
        "joint": Marginals(ring.graph, result.values).joint(x[[1, 2]], frame="world"),
        "stops": [nls.Stop(max_iterations=3), *nls.Status, *nls.Fit],
        "optimizers": [nls.GaussNewton(nls.Stop(1e-9)), nls.LevenbergMarquardt(), nls.Dogleg()],
        "solvers": [solver() for solver in solvers],
        "explanation": nls.explain(ring.graph, ring.start),
        "certificate": nls.certify(ring.graph, result.values),
        "robustified": nls.gnc(ring.graph, ring.start),
        "observability": observability(fixed, seen, s[0]),
        "scales": nls.variance_components(ring.graph, ring.start),
        "unverified": Unverified(((0, 1),), ("Between(x0, x9)",), 0.01, 2.0, 1.0, 5.0),
        "landmarks": landmark_information(sea.graph, sea.truth, "l"),
        "motions": helpful_motions(pings, nls.Values({x: (SE2, seen[x][:2]), l: (R(2), seen[l])}), l[0]),
        "worlds": [ring, sea, lines, rig, rig.errors(rig.start), mission],
        "sensors": [DIDSON_HIGH, HOLOOCEAN_DVL, Camera()],
        "harbor": sim.harbor(np.random.default_rng(0), keyframes=40, laps=1),
        "scene": sim.Scene(walls=[[[8.0, -9.0], [8.0, 9.0]]], piles=[[5.0, 1.0, 0.3]], rocks=[[4.0, -2.0]]),
        "error of a trajectory": ate(ring.start[x], ring.truth[x]),
        "files": list(nls.load(folder / "ring.g2o")),
        "steps": filters.steps(sea.graph, sea.start),
        "errors": [
            *(of("a sentence") for of in vars(errors).values() if raised(of) and of is not errors.OptionError),
            errors.OptionError("gauge", "firts", "first"),
            errors.GraphFileError("no number", "a.g2o", 17, "EDGE"),
            errors.UnderconstrainedError("free", x[0:2], 1, ["x0: yaw"], sea.start),
            SingularAt("behind the camera", 3),
            SingularSystemError("a pivot vanishes"),
            UnsolvedSystemError("too few steps"),
            errors.JacobianError("wrong", "Prior", (0, 1, 2, 3), 1.0, -1.0),
        ],
    }
    for filter in (
        filters.EKF(associate=filters.JointCompatibility()),
        filters.EKF(associate=filters.Nearest()),
        filters.EKF(associate=filters.Assignment()),
        filters.Smoother(5),
        filters.Smoother(),
        filters.FastSLAM(20, rng=np.random.default_rng(2)),
    ):
        made[f"track {len(made)}"] = filter.run(short.graph, short.start)
        made[f"filter {len(made)}"] = filter
    return made


def result_system(graph: Any, values: Any) -> Any:
    """The system at the values, everything in it computed."""
    system = graph.linearize(values)
    _ = system.A, system.gradient, system.column_norms
    return system


def raised(thing: Any) -> bool:
    return isinstance(thing, type) and issubclass(thing, Exception)
