"""Angles beyond a turn: measured ones are warned of with their line, those of vertices noted; nothing is refused."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import nls
from nls.cli import main
from tests.combinations import for_all
from tests.nls.io.g2o_files import PLANE, write
from tests.nls.io.io_files import PYFG, TORO_3

DEGREES = "these degrees?"


def test_degrees_in_an_edge_are_warned_of_and_turns_of_a_vertex_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (
        PLANE.replace("1.01 0.98 1.5", "1.01 0.98 86").replace("0.9 1.5", "0.9 -87").replace("2.1 3.0", "2.1 15.5664")
    )
    path = write(tmp_path, text)
    with pytest.warns(nls.GraphWarning, match=r"^.*: 2 lines .* first on line 6 \(EDGE_SE2\): 86"):
        graph, _, report = nls.load(path)
    assert report.warnings[0].endswith(DEGREES)
    (note,) = (note for note in report.notes if note not in report.warnings)
    assert note.startswith("1 line has an angle of more than a turn, first on line 4 (VERTEX_SE2): 15.5664")
    assert graph.factors[0].z[1, 2] == 86  # read as it is
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(["solve", str(path), "--quiet", "--allow-unconverged"]) in (0, 1)
    assert f"nls: warning: {path}: 2 lines have an angle" in capsys.readouterr().err
    for angle in ("6.2832", "-6.28", "3.2", "0"):  # up to a turn
        assert nls.load(write(tmp_path, PLANE.replace("1.01 0.98 1.5", f"1.01 0.98 {angle}")))[2].notes == []


def test_roll_pitch_and_yaw_of_toro_and_poses_of_pyfg(tmp_path: Path) -> None:
    with pytest.warns(nls.GraphWarning, match=r"first on line 4 \(EDGE3\): -20.5"):
        nls.load(write(tmp_path, TORO_3.replace("0.11 -0.21 0.41", "0.11 -20.5 10.41"), "a.toro"), dialect="toro")
    line, text = next((k, row) for k, row in enumerate(PYFG.splitlines(), 1) if row.startswith("EDGE_SE2 "))
    words = text.split()
    words[6] = "45.5"
    with pytest.warns(nls.GraphWarning, match=rf"1 line has .* first on line {line} \(EDGE_SE2\): 45.5"):
        nls.load(write(tmp_path, PYFG.replace(text, " ".join(words)), "a.pyfg"))


def test_a_prior_of_pyfg_is_a_measurement_and_its_vertex_none(tmp_path: Path) -> None:
    lines = [*PYFG.splitlines(), "VERTEX_SE2:PRIOR 0.5 A0 0 0 0 0.01 0 0 0.01 0 0.001"]
    prior, vertex = (
        next(k for k, line in enumerate(lines) if line.startswith(f"{tag} "))
        for tag in ("VERTEX_SE2:PRIOR", "VERTEX_SE2")
    )
    for at in (prior, vertex):
        words = lines[at].split()
        words[5] = "90"
        lines[at] = " ".join(words)
    with pytest.warns(nls.GraphWarning, match=rf"1 line has .* first on line {prior + 1} \(VERTEX_SE2:PRIOR\): 90"):
        _, _, report = nls.load(write(tmp_path, "\n".join(lines), "a.pyfg"))
    (note,) = (note for note in report.notes if DEGREES in note and note not in report.warnings)
    assert f"first on line {vertex + 1} (VERTEX_SE2): 90" in note


@for_all(name=["ring.g2o", "kitti_00.g2o", "input_INTEL.g2o"])
def test_no_public_graph_is_warned_of(data: Path, name: str) -> None:
    _, values, report = nls.load(data / "pose-graphs-2d" / name)
    assert not any(DEGREES in note for note in report.notes)
    assert np.abs(values.stacks["x"].X[:, 2]).max() < 6.2832
