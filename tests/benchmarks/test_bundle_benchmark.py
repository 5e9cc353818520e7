"""The table of solvers for many points can be made, and all of them arrive at the same estimate."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nls import Cholesky

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "benchmarks" / "bundle.py"

pytestmark = [
    pytest.mark.skipif(not SCRIPT.exists(), reason="there are no benchmarks here (an installed copy has none)"),
    pytest.mark.skipif(Cholesky.missing() is not None, reason="CHOLMOD is one of the solvers compared"),
]


def test_the_table_of_solvers(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", str(SCRIPT), "--quick", "--out", str(tmp_path)]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in (tmp_path / "bundle.md").read_text().splitlines() if line.startswith("| rig 50")]
    rows = {cells[5].strip(" `"): [cell.strip() for cell in cells] for cells in (line.split("|") for line in lines)}
    assert list(rows) == ["cholesky", "schur", "pcg", "pcg, tol 0.1"]
    for name, cells in rows.items():
        assert float(cells[7]) > 0
        assert float(cells[13]) == pytest.approx(float(rows["cholesky"][13]), rel=1e-5)
        assert float(cells[14]) < (1e-4 if name == "pcg, tol 0.1" else 1e-8)
