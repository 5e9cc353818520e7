"""TUM and KITTI trajectories: what is written comes back, what is no pose is refused with its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models import SE3
from models.algebra import Array
from models.manifolds.so3 import rotation3
from nls import GraphError
from nls.io.trajectory import lifted, read_kitti, read_tum, write_kitti, write_tum
from tests.combinations import for_all
from tests.nls.io.g2o_files import assert_refused, write


def poses(n: int = 30) -> Array:
    rng = np.random.default_rng(3)
    return np.concatenate([SE3.exp(2 * rng.normal(size=(n - 1, 6))), [[0, 0, 0, 1, 0, 0, 0]]])  # a half turn, too


@for_all(name=["a.tum", "a.tum.gz"])
def test_tum_goes_round_bit_for_bit(name: str, tmp_path: Path) -> None:
    X, times = poses(), 1.7e9 + 0.1 * np.arange(30)
    write_tum(tmp_path / name, times, X)
    t, Y = read_tum(tmp_path / name)
    assert np.array_equal(t, times)
    assert np.array_equal(Y, X)


def test_tum_as_others_write_it(tmp_path: Path) -> None:
    head = "# timestamp tx ty tz qx qy qz qw\n\n  #no space\n"
    text = head + "1305031102.1758 1.3405 0.6266 1.6575 0 0 0.6 -0.8\n2e9 1 2 3 0 0 0 1\n"
    t, X = read_tum(write(tmp_path, text, "a.tum"))
    assert t.tolist() == [1305031102.1758, 2e9]
    assert X.tolist() == [[1.3405, 0.6266, 1.6575, 0, 0, 0.6, -0.8], [1, 2, 3, 0, 0, 0, 1]]


def test_kitti_is_the_matrix_row_by_row(tmp_path: Path) -> None:
    X = poses()
    write_kitti(tmp_path / "a.kitti", X)
    table = np.loadtxt(tmp_path / "a.kitti")
    assert table.shape == (30, 12)
    assert np.allclose(table.reshape(30, 3, 4)[:, :, 3], X[:, :3], rtol=0, atol=0)
    assert np.allclose(table.reshape(30, 3, 4)[:, :, :3], rotation3(X[:, 3:]), rtol=0, atol=1e-15)
    assert np.abs(SE3.local(X, read_kitti(tmp_path / "a.kitti"))).max() < 1e-14
    quarter = "0 -1 0 5 1 0 0 6 0 0 1 7\n"
    (pose,) = read_kitti(write(tmp_path, quarter, "b.kitti"))
    assert pose == pytest.approx([5, 6, 7, 0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def test_poses_of_the_plane_are_lifted(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", [0, 1], [[1.0, 2.0, np.pi / 2], [3.0, 4.0, -3.0]])
    _, X = read_tum(tmp_path / "a.tum")
    assert X[:, :3].tolist() == [[1, 2, 0], [3, 4, 0]]
    assert SE3.log(X)[:, 3:] == pytest.approx(np.array([[0, 0, np.pi / 2], [0, 0, -3.0]]))
    assert np.array_equal(lifted(X), X)


LINE = "1 2 3 0 0 0 1"


def test_every_mistake_has_its_line(tmp_path: Path) -> None:
    for text, line, words in (
        ("", 1, "has no pose"),
        (f"0 {LINE}\n1 2 3 0 0 0 1\n", 2, "7 numbers, expected 8: timestamp"),
        (f"0 {LINE}\n1 1 2 3 0 0 0 1.1\n", 2, "length 1.1"),
        (f"0 {LINE}\n1 1 2 3 0 1e300 0 1\n", 2, "length inf"),
        (f"0 {LINE}\n\n1 1 2 x 0 0 0 1\n", 3, "'x'"),
        (f"0 {LINE}\n1.5 {LINE}\n# c\n1.5 {LINE}\n2 {LINE}\n", 4, "time 1.5 does not rise over 1.5"),
        (f"2 {LINE}\n1 {LINE}\n", 2, "time 1.0 does not rise over 2.0"),
    ):
        assert_refused(line, words, read_tum, write(tmp_path, text, "a.tum"))
    for row, words in (
        ("1 0 0 0 0 1 0 0 0 0 1", "11 numbers, expected 12"),
        ("1 0 0 0 0 1 0 0 0 0 1.01 0", "off the identity by 0.02"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "determinant is -1"),
        ("1e200 0 0 0 0 1 0 0 0 0 1 0", "no rotation matrix"),
        ("0 -1 0 1.5 1e-308 0 0 0.25 0 0 1 2", "no rotation matrix"),
    ):
        assert_refused(2, words, read_kitti, write(tmp_path, f"1 0 0 0 0 1 0 0 0 0 1 0\n{row}\n", "a.kitti"))


def test_arrays_that_are_no_trajectory_are_not_written(tmp_path: Path) -> None:
    two: list[tuple[Any, Any, str]] = [
        ([0.0], poses(2), r"shape \(1,\), expected \(2,\)"),
        ([0.0, 0.0], poses(2), "rise"),
        ([0.0, np.nan], poses(2), "finite"),
        ([0.0, 1.0], poses(2)[:, :4], r"shape \(2, 4\)"),
        ([0.0, 1.0], 2 * poses(2), "expected 1"),
        ([0.0, [1.0]], poses(2), "times"),
        ([0.0], [["a", 0, 0]], "poses .*'a'"),
        ([], np.zeros((0, 7)), "no poses"),
    ]
    for times, X, message in two:
        with pytest.raises(GraphError, match=rf"a\.tum: .*{message}"):
            write_tum(tmp_path / "a.tum", times, X)
    for X, message in (([["a", 0, 0]], "not an array of numbers"), (np.zeros((0, 3)), "no poses")):
        with pytest.raises(GraphError, match=rf"a\.kitti: .*{message}"):
            write_kitti(tmp_path / "a.kitti", X)
    assert list(tmp_path.iterdir()) == []
