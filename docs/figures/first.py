"""Left: dead reckoning of two rounds of a square, which drifts away from the square. Right: with its loop closures the
track lies on the square.

The picture of the README; `python docs/figures/first.py` writes it to docs/images/first.png.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import nls
import sim
from factors import Between, Diagonal
from models import SE2

WIDTH = 1040  # pixels
EXACT = np.full((40, 3), [2.0, 0.0, 0.0])  # 40 steps of 2 m, a quarter turn after every fifth: twice around a square
EXACT[4::5, 2] = np.pi / 2


def make() -> tuple[list[Figure], list[float]]:
    """The picture."""
    (x,) = nls.kinds("x")
    sigma = [0.1, 0.1, 0.05]  # m, m, rad
    noise, rng = Diagonal(sigma), np.random.default_rng(24)
    odometry = Between(x[0:40], x[1:41], EXACT + rng.normal(0, sigma, (40, 3)), noise)
    closures = Between(x[0:20], x[20:40], rng.normal(0, sigma, (20, 3)), noise)
    graph = nls.FactorGraph([odometry, closures])
    unknown = nls.Values({x: (SE2, np.zeros((41, 3)))})
    start, *_ = nls.initialize(graph, unknown, "odometry")
    result = graph.optimize(start)
    truth, *_ = nls.initialize(nls.FactorGraph([Between(x[0:40], x[1:41], EXACT, noise)]), unknown, "odometry")
    figure = sim.against_truth(graph, truth, {"dead reckoning": start, "loops closed": result.values})
    figure.set_size_inches(7.6, 3.8)  # its words are read on a phone, too
    return [figure], [0.0]


if __name__ == "__main__":
    (figure,), _ = make()
    figure.savefig(Path(__file__).parents[1] / "images" / "first.png", dpi=WIDTH / figure.get_figwidth())
