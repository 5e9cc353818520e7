"""The table of elimination orders can be made, and all three orders give the same step."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nls import Cholesky

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "benchmarks" / "schur.py"

pytestmark = [
    pytest.mark.skipif(not SCRIPT.exists(), reason="there are no benchmarks here (an installed copy has none)"),
    pytest.mark.skipif(Cholesky.missing() is not None, reason="the order of CHOLMOD is what is measured"),
]


def test_the_table_of_elimination_orders(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", str(SCRIPT), "--quick", "--flops", "1e10", "--out", str(tmp_path)]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in (tmp_path / "schur.md").read_text().splitlines() if line.startswith("| floor")]
    rows = {cells[5].strip(" `"): [cell.strip() for cell in cells] for cells in (line.split("|") for line in lines)}
    assert list(rows) == ["schur", "cholesky", "natural"]
    assert rows["natural"][7] == "not run"
    flops = {name: float(cells[10].replace(",", "")) for name, cells in rows.items()}
    assert flops["natural"] > 20 * max(flops["schur"], flops["cholesky"])
    for name in ("schur", "cholesky"):
        assert float(rows[name][7]) > 0
        assert float(rows[name][12]) < 1e-12
