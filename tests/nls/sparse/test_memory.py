"""Memory that arrays have left is used again, instead of being given back to the system and cleared once more."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from weakref import ref

import pytest

from models import SE2
from models.algebra import Array
from nls import GaussNewton
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values
from tests.nls.graphs import pose_graph

PAGES = """
import resource
import numpy as np
{first}

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def iteration():
    arrays = [np.ones(1 << 18) for _ in range(8)]

for _ in range(3):
    iteration()
begin = faults()
for _ in range(5):
    iteration()
print(faults() - begin)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep memory in their own way")
def test_arrays_of_the_next_iteration_need_no_new_pages() -> None:
    def new_pages(first: str) -> int:
        command = [sys.executable, "-c", PAGES.format(first=first)]
        env = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC_", "GLIBC_"))}
        return int(subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout)

    assert new_pages("import nls.graph") < new_pages("") / 5  # 0 and 20,000 of 4 KB


def test_gauss_newton_has_one_linearization_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    at, arrays = LinearSystem.at, list[ref[Array]]()

    def watched(pattern: Pattern, values: Values) -> LinearSystem:
        assert not any(array() is not None for array in arrays)
        system = at(pattern, values)
        arrays.extend(map(ref, (system.b, *system.blocks[0])))
        return system

    monkeypatch.setattr(LinearSystem, "at", watched)
    sample = pose_graph(SE2)
    assert sample.graph.optimize(sample.values, GaussNewton()).converged
    assert len(arrays) >= 3 * 3
