"""The map from scans: closures by color, dead reckoning and the truth where there is one, all in meters alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors.keys import kinds
from models import SE2
from nls.missions.pictures.scan_map import scan_map
from nls.missions.scans import close
from nls.missions.scans.folder import Truth, read_scan_mission
from nls.plot.style import CLOSURE, REJECTED
from tests.nls.missions.scans.room_files import room, track, write

x = kinds("x")[0]


def test_what_is_drawn(tmp_path: Path) -> None:
    graph, values, scans, report = read_scan_mission(write(tmp_path / "m", room()))
    closing = close(graph, values, scans, rounds=1)
    matches = closing.matches
    matches.kept[np.flatnonzero(matches.kept)[:2]] = False
    elsewhere = SE2.compose(np.repeat([[30.0, -20.0, 2.0]], 90, axis=0), report.truth.poses)
    figure = scan_map(closing.values[x], values[x], scans, matches, Truth(report.truth.rows, elsewhere))
    (axes,) = figure.axes
    lines = {str(line.get_label()): line for line in axes.lines}
    assert [*lines] == ["dead reckoning", "truth, aligned", "solution", "start"]
    assert lines["dead reckoning"].get_linestyle() == "--"
    truth = np.column_stack(lines["truth, aligned"].get_data())
    solution = np.column_stack(lines["solution"].get_data())
    assert 0 < np.linalg.norm(truth - solution, axis=1).max() < 1
    np.testing.assert_allclose(np.diff(truth, axis=0)[:3], np.diff(track(2)[:4, :2], axis=0), atol=0.05)
    closures = {c.get_label(): c for c in axes.collections if str(c.get_label()).endswith(("kept", "rejected"))}
    rejected = int((matches.accepted & ~matches.kept).sum())
    kept = int(matches.kept.sum())
    assert {*closures} == {f"{rejected} closures rejected", f"{kept} closures kept"}
    for label, color, alpha, count in (
        (f"{kept} closures kept", CLOSURE, 0.45, kept),
        (f"{rejected} closures rejected", REJECTED, 0.35, rejected),
    ):
        lines_of = closures[label]
        assert (lines_of.get_alpha(), len(lines_of.get_paths())) == (alpha, count)
        assert tuple(round(255 * c) for c in lines_of.get_edgecolor()[0][:3]) == tuple(bytes.fromhex(color[1:]))
    assert axes.get_aspect() == 1
    alone = scan_map(values[x], values[x], scans).axes[0]
    assert "90 keyframes" in alone.get_title()
    assert [line.get_label() for line in alone.lines] == ["dead reckoning", "solution", "start"]
