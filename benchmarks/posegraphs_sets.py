"""The sets of posegraphs.py: public pose graphs, or simulated worlds; each as one plain g2o file for all contenders."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from harness import POSE_GRAPHS
from peers import Files

SETS = {
    name: (path, "isam" if path.endswith(".txt") else "auto") for name, path in POSE_GRAPHS.items()
}  # file, dialect
QUICK = ("ring", "smallGrid3D")
STAGED = ("sphere2500", "city10000")  # of these also the stages and all marginals


@dataclass
class Problem:
    """A set ready for all contenders, and what evaluates their solutions."""

    name: str
    files: Files
    edges: int
    poses: int
    dof: int = 0
    graphs: dict[str, Any] = field(default_factory=dict)  # by convention
    values: Any = None

    def chi2(self, ids: npt.NDArray[np.int64], X: npt.NDArray[np.float64], convention: str) -> float:
        return float(self.graphs[convention].chi2(self.placed(ids, X)))

    def placed(self, ids: npt.NDArray[np.int64], X: npt.NDArray[np.float64]) -> Any:
        return self.values.replaced({"x": X[np.searchsorted(ids, self.values.stack("x").numbers)]})

    def optimum(self, ids: npt.NDArray[np.int64], X: npt.NDArray[np.float64], convention: str) -> float:
        """Where a solution leads in a convention, to the last digits."""
        import nls

        to_the_end = nls.GaussNewton(nls.Stop(chi2_rtol=1e-13, update_tol=1e-10))
        return float(self.graphs[convention].optimize(self.placed(ids, X), to_the_end).chi2_final)


def prepare(name: str, folder: Path, data: str | None) -> Problem:
    """Write a set as one plain g2o file."""
    import nls
    import sim
    from nls.io.files import read_bytes

    worlds = {
        "ring": lambda rng: sim.ring(rng, laps=4, per_lap=50),
        "smallGrid3D": lambda rng: sim.grid3d(rng, n_poses=125),
        "sphere2500": lambda rng: sim.sphere(rng, rings=50, per_ring=50),
        "city10000": lambda rng: sim.manhattan(rng, n_poses=10_000),
    }
    path = folder / f"{name.replace(' ', '-')}.g2o"
    if data is None:
        world = worlds[name](np.random.default_rng(1))
        nls.save(path, world.graph, world.start)
    else:
        source, dialect = Path(data) / SETS[name][0], SETS[name][1]
        graph, values, report = nls.load(source, dialect=dialect)
        if report.format == "g2o":
            path.write_bytes(read_bytes(source))  # unpacked
        else:
            nls.save(path, graph, values)
    graphs = {convention: nls.load(path, convention)[0] for convention in ("g2o", "gtsam")}
    graph, values, _ = nls.load(path)
    complete = path
    if b"VERTEX" not in path.read_bytes():
        nls.save(complete := folder / f"{path.stem}-complete.g2o", graph, values)
    stack = values.stack("x")
    d = stack.manifold.dim
    files = Files(path, complete, d == 6)
    return Problem(name, files, len(graph), len(stack), d * (len(graph) - len(stack) + 1), graphs, values)
