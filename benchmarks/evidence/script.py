"""The harness of the benchmarks, for the scripts of this folder."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from harness import (
    GTSAM,
    ONE_THREAD,
    POSE_GRAPHS,
    Table,
    child,
    fresh,
    line_of,
    make_page,
    markdown,
    over,
    pooled,
    spread,
    timed,
)

__all__ = ["GTSAM", "ONE_THREAD", "POSE_GRAPHS", "Table", "child", "fresh", "line_of", "make_page", "markdown"]
__all__ += ["over", "pooled", "spread", "timed"]
