"""Contenders of posegraphs.py, one a file. Each file has the same names:

PACKAGE           the import name; imported when a Run is made, before the clock starts
VARIANTS          how it can be run, in words separated by commas
COST              the residual convention of its chi2, `g2o` or `gtsam`
Run(files, variant)
    load(), start(), optimize()   each timed
    poses()       ids (n,) and poses (n, 3) or (n, 7), as in a g2o file
    iterations    taken by optimize
    cost()        of its solution as the library itself computes it, as a chi2: compared with the one evaluated here
    said          of a peer its version; what else it has to say, for the JSON
    marginals()   covariances of all poses; only where the contender is asked for them

Those of PROGRAMS run without Python. Instead of PACKAGE and Run they have:

SOURCE            their C++ source beside this file; see driver.h
LIBRARIES         names of the libraries it is linked with
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path

__all__ = ["CONTENDERS", "PROGRAMS", "TOLERANCE", "Files", "combined"]

CONTENDERS = ("leadline", "gtsam", "g2o_cpp", "ceres_cpp")
PROGRAMS = ("g2o_cpp", "ceres_cpp")
TOLERANCE = 1e-6  # relative decrease of the cost that ends an optimization


@dataclass(frozen=True)
class Files:
    """A set as g2o files."""

    graph: Path
    complete: Path  # the same with a start for every pose, for those that need one
    space: bool
    most: int = 100  # iterations


def combined(*parts: tuple[str, ...]) -> tuple[str, ...]:
    """Every combination of the words."""
    return tuple(", ".join(words) for words in product(*parts))
