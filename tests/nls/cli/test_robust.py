"""``nls solve --robust gnc-tls``: the wrong closures in the table, the report, the page and the output."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from tests.nls.cli.shell import Shell
from tests.nls.robust.test_graduated import names, wrong_closures


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str]]:
    """A city with twenty wrong closures in two groups, and their names."""
    world = sim.manhattan(np.random.default_rng(3), n_poses=300)
    wrong = wrong_closures(world, 20, np.random.default_rng(4), 10)
    path = tmp_path_factory.mktemp("spoiled") / "city.g2o"
    nls.save(path, nls.FactorGraph([*world.graph.factors, wrong]), world.truth)
    return path, names(wrong)


@pytest.mark.usefixtures("undrawn")
def test_what_was_rejected_is_said_and_left_out(spoiled: tuple[Path, set[str]], shell: Shell) -> None:
    path, wrong = spoiled
    out, record = shell.told(f"solve {path} --robust gnc-tls --certify --report p.html -o out.g2o")
    rejected = {each["factor"] for each in record["rejected"]}
    assert wrong <= rejected
    lines = path.read_text().splitlines()
    for each in record["rejected"]:
        assert each["file"] == str(path)
        assert lines[each["line"] - 1].split()[1:3] == re.findall(r"x(\d+)", each["factor"])
    assert (record["init"], record["certificate"]["verdict"]) == ("gnc-tls", "certified")
    assert f"{len(rejected)} of {record['doubted']} doubted measurements rejected" in out
    assert f"about {record['expected_by_chance']:.0f} are expected by chance at 99 %" in out
    assert record["rejected"][0]["factor"] in out
    assert "without the" in out
    assert sum(name in (shell / "p.html").read_text() for name in wrong) >= 5
    before, (graph, values, _) = nls.load(path)[0], nls.load("out.g2o")
    written = {factor.describe(k) for factor in graph.factors for k in range(len(factor))}
    assert not written & wrong
    assert len(before) - len(graph) == len(rejected)
    assert graph.chi2(values) == pytest.approx(record["chi2_final"])


def test_other_losses_and_plain_least_squares(spoiled: tuple[Path, set[str]], shell: Shell) -> None:
    path, wrong = spoiled
    record = shell.report(f"solve {path} --robust gnc-gm:0.999")
    assert wrong <= {each["factor"] for each in record["rejected"]}
    assert record["init"] == "gnc-gm:0.999"
    assert "rejected" not in shell.report(f"solve {path}", 1)


def test_what_is_left_keeps_its_times(shell: Shell) -> None:
    lines = [f"VERTEX_SE2 {k}.5 A{k} {k} 0 0" for k in range(8)]
    pairs = [(i, i + step) for step in (1, 2) for i in range(8 - step)]
    good = [f"EDGE_SE2 {i}.{j} A{i} A{j} {j - i} 0 0 0.01 0 0 0.01 0 0.01" for i, j in pairs]
    wrong = "EDGE_SE2 9.25 A1 A6 9 9 0 0.01 0 0 0.01 0 0.01"
    file = shell.file("\n".join([*lines, *good[:9], wrong, *good[9:]]), "a.pyfg")
    shell(f"solve {file} --robust gnc-tls -o b.pyfg --quiet --allow-doubtful")  # with sigmas larger than the map
    ((_, times),) = nls.load("b.pyfg")[2].factor_times
    assert times.tolist() == [float(line.split()[1]) for line in good]


def test_lines_that_stay_keep_their_digits(shell: Shell) -> None:
    """Weights of angles are turned while they are read; what is kept is written as the file had it."""
    world = sim.sphere(np.random.default_rng(1), rings=8, per_ring=12)
    wrong = wrong_closures(world, 5, np.random.default_rng(4))
    nls.save("ball.graph", nls.FactorGraph([*world.graph.factors, wrong]), world.truth, dialect="toro")
    rejected = len(shell.report("solve ball.graph --robust gnc-tls -o out.toro --allow-doubtful")["rejected"])
    before, after = (
        [line for line in (shell / name).read_text().splitlines() if line.startswith("EDGE3")]
        for name in ("ball.graph", "out.toro")
    )
    assert rejected >= len(wrong) > 0
    assert len(after) == len(before) - rejected
    assert set(after) < set(before)
