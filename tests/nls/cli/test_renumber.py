"""``--renumber``: numbers that clash are refused with the option's name, and new on request; the old ones in a note."""

from __future__ import annotations

import numpy as np
import pytest

import nls
from nls import kinds
from tests.nls.cli.shell import Shell, rows
from tests.nls.missions.charts.charted import charted

x, l = kinds("x", "l")


def test_landmarks_go_behind_the_largest_pose_and_the_optimum_is_the_same(shell: Shell) -> None:
    scene = charted()
    nls.save("subsea.npz", scene.graph, scene.start)
    n, m = (len(scene.start.stack(kind)) for kind in (x, l))
    note = f"{m} variables have new numbers: l{n} to l{n + m - 1} were l0 to l{m - 1}"
    assert rows(shell("convert subsea.npz subsea.g2o --renumber"), "note") == [note]
    one, two = (
        shell.report(f"solve {name} --convention log --allow-doubtful") for name in ("subsea.npz", "subsea.g2o")
    )
    assert two["chi2_final"] == pytest.approx(one["chi2_final"], rel=1e-6)
    assert note in rows(shell("solve subsea.npz -o solved.g2o --renumber --allow-doubtful"), "note")
    shell("solve subsea.npz -o solved.npz --allow-doubtful")
    solved, named = (nls.load(name, "log")[1] for name in ("solved.g2o", "solved.npz"))
    assert solved.stack(l).numbers.tolist() == list(range(n, n + m))
    assert named.stack(l).numbers.tolist() == list(range(m))
    assert all(np.array_equal(solved[kind], named[kind]) for kind in (x, l))
    comments = [line for line in (shell / "solved.g2o").read_text().splitlines() if line.startswith("#")]
    assert comments == []  # some readers lose a file's edges over one


def test_without_the_option_the_refusal_names_it(shell: Shell) -> None:
    scene = charted()
    nls.save("subsea.npz", scene.graph, scene.start)
    for command in ("convert subsea.npz a.g2o", "solve subsea.npz -o a.g2o", "convert subsea.npz a.toro"):
        problem, renumber, native = shell.refused(command).splitlines()
        assert "x0 and l0 have one number" in problem
        assert renumber.endswith("give the variables whose numbers clash new numbers: --renumber")
        assert ".npz or .json" in native
    with pytest.raises(nls.GraphError, match=r"x0 and l0 have one number") as caught:
        nls.save("a.g2o", scene.graph, scene.start)
    assert "nls.save(..., renumber=True)" in str(caught.value)


def test_formats_that_need_no_new_numbers_refuse_the_option(shell: Shell) -> None:
    scene = charted()
    nls.save("subsea.npz", scene.graph, scene.start)
    for name in ("a.npz", "a.json", "a.pyfg", "a.isam", "a.tum", "a.bal"):
        assert "--renumber: " in shell.refused(f"convert subsea.npz {name} --renumber")
    assert "expected an output in one of the formats g2o, toro, graph" in shell.refused("solve subsea.npz --renumber")
    with pytest.raises(nls.OptionError, match="renumber: 'npz' is not possible"):
        nls.save("a.npz", scene.graph, scene.start, renumber=True)
