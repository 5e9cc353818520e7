"""The harness of the benchmarks, for the scripts of this folder."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from harness import ONE_THREAD, Table, line_of, make_page, markdown, positive, public_data, spread

__all__ = ["ONE_THREAD", "Table", "line_of", "make_page", "markdown", "positive", "public_data", "spread"]
