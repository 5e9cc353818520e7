"""Small g2o files for the tests of the reader, the starts and the command line."""

from __future__ import annotations

from pathlib import Path

INFORMATION_2 = "500 1 2 400 3 300"
UPPER_3 = "100 1 2 3 4 5 200 6 7 8 9 300 10 11 12 400 13 14 500 15 600"

PLANE = f"""VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0.1 0.1
VERTEX_SE2 2 1.9 1 1.6
VERTEX_SE2 3 1.0 2.1 3.0
EDGE_SE2 0 1 1 0 0.05 {INFORMATION_2}
EDGE_SE2 1 2 1.01 0.98 1.5 {INFORMATION_2}
EDGE_SE2 2 3 1.02 0.9 1.5 {INFORMATION_2}
EDGE_SE2 0 3 1.05 2.05 3.1 {INFORMATION_2}
"""

SPACE = f"""VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0.1 0 0 0 0.19866933079506122 0.98006657784124163
VERTEX_SE3:QUAT 2 2 0.1 0.5 0.099833416646828155 0 0 0.99500416527802582
EDGE_SE3:QUAT 0 1 1.01 0 0.02 0 0 0.19866933079506122 0.98006657784124163 {UPPER_3}
EDGE_SE3:QUAT 1 2 0.9 0 0.4 0.099833416646828155 0 0 0.99500416527802582 {UPPER_3}
EDGE_SE3:QUAT 0 2 1.9 0.2 0.4 0 0.099833416646828155 0 0.99500416527802582 {UPPER_3}
"""


def write(folder: Path, text: str | bytes, name: str = "graph.g2o") -> Path:
    """A file with this content."""
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path
