"""Bundle-adjustment files: every number comes back, every mistake has its line, known costs are met."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factors import BundleProjection, Huber, Isotropic, Prior
from factors.bundle import CAMERA, LENS
from models import R
from nls import FactorGraph, Values, kinds, save
from nls.io.bal import read_bal
from nls.io.files import read_bytes
from tests.nls.io.g2o_files import assert_refused, assert_unwritable

c, k, l = kinds("c", "k", "l")

HEAD = ["2 3 4"]
SEEN = ["0 0 -3.859900e+02 3.871200e+02", "1 0 -38.44 492.12", "0 1 383.88 -15.29999", "1 2 5.5e-3 .25"]
CAMERAS = [f"{value}" for value in (0.01, -0.02, 0.03, 0.1, 0.2, -1.5, 500, -1e-7, 1e-13, 0, 0, 0, 0, 0, -2, 510, 0, 0)]
POINTS = ["-0.6", "0.5", "-9", "0.1", "0.2", "-8.25", "1", "2", "-7"]
GOOD = [*HEAD, *SEEN, *CAMERAS, *POINTS]


def read(lines: list[str]) -> tuple[FactorGraph, Values, object]:
    return read_bal("\n".join(lines).encode() + b"\n", "b.txt")


def test_what_is_read() -> None:
    graph, values, report = read(GOOD)
    (factor,) = graph.factors
    assert isinstance(factor, BundleProjection)
    assert [keys.numbers.tolist() for keys in factor.keys] == [[0, 1, 0, 1], [0, 1, 0, 1], [0, 0, 1, 2]]
    assert [keys.kind for keys in factor.keys] == ["c", "k", "l"]
    assert values[k].tolist() == [[500.0, -1e-7, 1e-13], [510.0, 0.0, 0.0]]
    assert str(report).splitlines()[0] == "b.txt: bal, 3-D, convention none"
    # camera 1 looks along -z from (0, 0, 2), undistorted: p = -(X, Y) / (Z - 2), image 510 p
    e = factor.z[1] - 510 * np.array([-0.6, 0.5]) / 11
    assert factor.chi2(values)[1] == pytest.approx(e @ e, rel=1e-12)


def test_blank_lines_and_parameters_in_rows() -> None:
    camera_rows = [" ".join(CAMERAS[:9]), "", " ".join(CAMERAS[9:])]
    again = read(["", *HEAD, "", *SEEN, "", *camera_rows, " ".join(POINTS)])
    same(read(GOOD), again)


def same(one: tuple[FactorGraph, Values, object], two: tuple[FactorGraph, Values, object]) -> None:
    for kind, stack in one[1].stacks.items():
        assert np.array_equal(stack.X, two[1].stacks[kind].X)
    for f, g in zip(one[0].factors, two[0].factors, strict=True):
        assert (f.keys, f.z.tolist()) == (g.keys, g.z.tolist())


# lines of GOOD from and to, put there instead, line of the mistake, words of the error
MISTAKES: list[tuple[int, int, list[str], int, str]] = [
    (0, 99, [""], 1, "is empty"),
    (0, 1, ["2 3"], 1, "three counts"),
    (0, 1, ["2 3 x"], 1, "'x'"),
    (0, 1, ["2 3 -4"], 1, "at least one camera"),
    (0, 1, ["2 3 4000000000000000000"], 6, "observation 4 of 4000000000000000000 has 1 numbers"),
    (3, 4, [], 5, "observation 3 of 4 has 1 numbers, expected 4: camera point x y"),
    (2, 3, ["2 0 1 1"], 3, "camera 2 is none of the 2"),
    (2, 3, ["-1 0 1 1"], 3, "camera -1 is none of the 2"),
    (4, 5, ["1 3 1 1"], 5, "point 3 is none of the 3"),
    (4, 5, ["1 1.0 1 1"], 5, "'1.0'"),
    (10, 11, ["1e999"], 11, "beyond the largest number"),
    (3, 99, [], 3, "ends after 2 observations, its first line announces 4"),
    (31, 99, [], 31, "26 numbers follow the observations, expected 9 x 2 + 3 x 3 = 27"),
    (31, 99, ["-79 4"], 32, "28 numbers follow the observations"),
    (99, 99, ["", "1"], 34, "this is the first too many"),
]


def test_every_mistake_has_its_line() -> None:
    for begin, end, lines, line, words in MISTAKES:
        assert assert_refused(line, words, read, [*GOOD[:begin], *lines, *GOOD[end:]]).path == "b.txt"


def test_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    wild = [repr(v) for v in (rng.normal(size=27) * 10.0 ** rng.integers(-20, 20, 27)).tolist()]
    before = read([*HEAD, *SEEN, *wild])
    save(tmp_path / "out.txt", before[0], before[1], dialect="bal")
    same(before, read_bal(read_bytes(tmp_path / "out.txt"), "b.txt"))
    assert (tmp_path / "out.txt").read_text().splitlines()[1] == "0 0 -385.99 387.12"


def test_what_the_format_has_no_line_for(tmp_path: Path) -> None:
    def refused(graph: FactorGraph, values: Values, message: str) -> None:
        assert_unwritable(tmp_path / "out.bal", message, graph, values)

    graph, values, _ = read(GOOD)
    prior = Prior(l[0], [0.0, 0.0, 0.0], Isotropic(1))
    refused(FactorGraph([*graph.factors, prior]), values, r"Prior\(l0\) cannot be written")
    crossed = BundleProjection(c[[0, 1]], k[[1, 0]], l[[0, 0]], [[0.0, 0.0]], Isotropic(1))
    refused(FactorGraph([crossed]), values, "must have the same number")
    for noise in (Isotropic(2), Isotropic([1, 2, 1, 1])):
        other = BundleProjection(*graph.factors[0].keys, graph.factors[0].z, noise)  # type: ignore[arg-type]
        refused(FactorGraph([other]), values, "the noise is not one pixel")
    refused(FactorGraph([graph.factors[0].robust(Huber(1.0))]), values, "robust")
    points = {l: (R(3), values[l], [0, 1, 3])}
    refused(graph, Values({c: (CAMERA, values[c]), k: (LENS, values[k]), **points}), "counts the variables l from 0")
    refused(graph, Values({c: (LENS, values[k]), k: (LENS, values[k]), l: (R(3), values[l])}), "holds \\(wx")
    graph.fix(k[[0, 1]])
    refused(graph, values, "is fixed, and")


def test_known_cost_and_gradient(data: Path) -> None:
    path = data / "bal" / "problem-49-7776-pre.txt.gz"
    graph, values, report = read_bal(read_bytes(path), str(path))
    assert report.tags == {"cameras": 49, "points": 7776, "observations": 31843}
    assert graph.chi2(values) / 2 == pytest.approx(850912.460680839605629, rel=1e-14)
    system = graph.linearize(values)
    assert np.linalg.norm(system.A.T @ system.b) == pytest.approx(2.39615629098822921515e7, rel=1e-11)
