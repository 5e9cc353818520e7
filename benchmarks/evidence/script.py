"""The harness of the benchmarks, for the scripts of this folder."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from harness import *  # noqa: F403 - the scripts of this folder find it here
