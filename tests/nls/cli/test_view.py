"""The page to turn and zoom: it loads nothing, its layers say what they are, and what the mouse says is right."""

from __future__ import annotations

import json
import re
import sys
from typing import Any

import numpy as np
import pytest

import nls.plot
import sim
from factors import Between, Information, Isotropic, Prior
from models import SE2, SE3, SO2
from nls import FactorGraph, GraphError, Values, kinds
from nls.io.report import LoadReport
from tests.nls.cli.shell import SPOILED, Shell
from tests.nls.cli.test_wrong_contacts import mission, written
from tests.nls.missions.scans.room_files import room, write

(x,) = kinds("x")


def figure_of(page: str) -> dict[str, dict[str, Any]]:
    """The layers in a page by their names; of several of one group the one that the mouse asks."""
    data = json.JSONDecoder().raw_decode(page, page.index("const { data, layout } = ") + 25)[0]["data"]
    return {re.sub(r" \(.*", "", layer["name"]): layer for layer in data}


def test_the_page_holds_all_and_loads_nothing() -> None:
    world = sim.ring(np.random.default_rng(0), laps=2, per_lap=8)
    figure = nls.plot.view(world.graph, world.truth, title="a </script><script src=http://x>", remark="<b>")
    figure.data[0].name = "</script>"
    page = nls.plot.view_page(figure)
    own = re.sub(r"<script>/\*\*.*?</script>", "", page, flags=re.DOTALL)  # the page without plotly
    assert len(own) < 60_000 < 4e6 < len(page) < 6e6
    assert re.findall(r"https?://|src=\W*http|@import|url\(", re.sub(r"&lt;.*?&gt;", "", own)) == []
    assert (own.count("<script"), own.count("</script>")) == (1, 1)


def test_what_is_rejected_is_red_and_names_its_line(shell: Shell) -> None:
    shell.file(SPOILED)
    shell("solve graph.g2o --robust gnc-tls --view page.html --quiet")
    page = (shell / "page.html").read_text()
    layers = figure_of(page)
    line = SPOILED.splitlines().index(next(text for text in SPOILED.splitlines() if text.startswith("EDGE_SE2 1 5 ")))
    assert "14 measurements, 1 more rejected" in page
    for text in layers["rejected"]["text"]:
        assert re.fullmatch(rf"<b>Between\(x1, x5\)</b><br>\S+ sigmas<br>graph.g2o:{line + 1}", text)
    assert layers["rejected"]["marker"]["color"] == nls.plot.style.REJECTED
    assert (
        len(layers["loop closures within 95 %"]["text"]) == 6 + 1
    )  # the chords, and the edge from the last to the first
    assert len(layers["other measurements"]["text"]) == 7
    assert "customdata[3]" in layers["track"]["hovertemplate"]
    shell("view graph.g2o")
    as_read = figure_of((shell / "graph-view.html").read_text())
    assert "rejected" not in as_read
    assert [f"graph.g2o:{line + 1}" in text for text in as_read["loop closures beyond 99.9 %"]["text"]].count(True) == 1


def test_a_mission_has_its_layers(shell: Shell) -> None:
    """Contacts are rejected and landmarks leave: the measurements that are left keep their lines."""
    written(shell / "m", mission(outliers=0.1))
    shell("solve m --view page.html --quiet")
    layers = figure_of((shell / "page.html").read_text())
    names = {"track", "dead reckoning", "truth", "landmarks l", "95 % ellipses of l", "lines of sight", "rejected"}
    assert names <= set(layers)
    rows = (shell / "m/contacts.csv").read_text().splitlines()
    for text in layers["rejected"]["text"][:5]:
        pose, landmark, line = re.search(r"x(\d+), l(\d+)\).*contacts.csv:(\d+)", text).groups()  # type: ignore[union-attr]
        assert rows[int(line) - 1].startswith(f"{pose},{landmark},")
    (shell / "m/truth.csv").unlink()
    (shell / "m/landmarks.csv").write_text("landmark,x_m,y_m,z_m\n987,1,1,1\n")  # a truth of nothing that was seen
    shell("view m -o page.html")
    assert not [name for name in figure_of((shell / "page.html").read_text()) if "truth" in name]


def test_a_scan_mission_has_its_points_and_its_times(shell: Shell) -> None:
    write(shell / "m", room())
    shell("solve m --view page.html --quiet")
    layers = figure_of((shell / "page.html").read_text())
    assert {"scans", "truth", "dead reckoning", "loop closures within 95 %"} <= set(layers)
    assert layers["track"]["meta"]["since"][3] == 11.0


def test_what_has_no_place_on_the_map_is_refused() -> None:
    turn = FactorGraph([Prior(x[0], [0.0], Isotropic(0.1))])
    for graph, values in ((turn, Values({x: (SO2, [[0.0]])})), (FactorGraph(), Values())):
        with pytest.raises(GraphError, match=r"no kind of the values has positions; nls.plot.factor_graph\(graph\)"):
            nls.plot.view(graph, values)
    nls.plot.factor_graph(turn)
    pose = Values({x: (SE2, [[0, 0, 0]])})
    for truth in (Values({x: (SE2, [[0, 0, 0]], [7])}), Values({x: (SE3, SE3.identity())}), Values()):
        with pytest.raises(GraphError, match="track 'truth' has no variable of the 2-D map; leave it out"):
            nls.plot.view(FactorGraph(), pose, tracks={"truth": truth})


def test_colors_count_what_is_measured() -> None:
    """|b|^2 = 7 is beyond 95 % of two numbers, not of three."""
    values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])})
    steps = Between(x[[0, 1]], x[[1, 2]], [1, 0, 0], Isotropic(0.1))
    for yaw, layer in ((0.0, "beyond 95 %"), (100.0, "within 95 %")):
        closure = Between(x[0], x[2], [2 + 0.1 * 7**0.5, 0, 0], Information(np.diag([100, 100, yaw])))
        first, *_ = nls.plot.view(FactorGraph([steps, closure]), values).data
        assert first.name == f"loop closures {layer} (1)"


def test_each_file_has_its_own_page(shell: Shell) -> None:
    for name in ("run.1.g2o", "run.2.G2O", "run.3"):
        shell.file(SPOILED, name)
        shell(f"view {name}")
    assert sorted(page.name for page in shell.folder.glob("*.html")) == [f"run.{k}-view.html" for k in (1, 2, 3)]


def test_the_slider_knows_since_when() -> None:
    """A closure is there when its later pose is; the clock is that of the file, unless its times go back."""
    values = Values({x: (SE2, [[2, 0, 0], [0, 0, 0], [1, 0, 0]], [7, 5, 6])})
    graph = FactorGraph([Between(x[[5, 6, 7]], x[[6, 7, 5]], [[1, 0, 0], [1, 0, 0], [-2, 0, 0]], Isotropic(0.1))])
    for times, since in (([30.0, 10.0, 20.0], [10, 20, 30]), ([10.0, 30.0, 20.0], [5, 6, 7])):
        report = LoadReport("", "", "", "", vertex_times={"x": np.array(times)})
        closure, *_, line, dots = nls.plot.view(graph, values, report).data
        np.testing.assert_array_equal(line.x, [0, 1, 2])
        assert dots.meta["since"] == line.meta["since"] == since
        assert (closure.meta["since"], closure.meta["stride"]) == (since[2:], 3)


def test_a_track_is_broken_where_a_dive_begins() -> None:
    values = Values({x: (SE2, np.eye(3)[[0, 1, 2, 0, 1, 2]], [0, 1, 2, 100, 101, 102])})
    graph = FactorGraph([Between(x[[0, 1, 100, 101]], x[[1, 2, 101, 102]], np.zeros((4, 3)), Isotropic(0.1))])
    *_, line, _ = nls.plot.view(graph, values).data
    assert np.isnan(line.x).tolist() == [False] * 3 + [True] + [False] * 2
    *_, line, _ = nls.plot.view(FactorGraph(), values).data  # poses alone
    assert np.isfinite(line.x).all()


def test_sixty_thousand_poses_are_thinned_with_a_word() -> None:
    k = np.arange(59_999)
    X = np.column_stack([np.cos(1e-3 * np.arange(60_000)), np.sin(1e-3 * np.arange(60_000)), np.zeros(60_000)])
    graph = FactorGraph([Between(x[k], x[k + 1], SE2.between(X[:-1], X[1:]), Isotropic(0.1))])
    page = nls.plot.view_page(nls.plot.view(graph, Values({x: (SE2, X)})))
    assert "track (60,000), every 3rd drawn" in page
    assert len(page) < 12e6


def test_without_plotly_a_sentence_says_how_to_get_it(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    shell.file(SPOILED)
    monkeypatch.setitem(sys.modules, "plotly", None)
    for words in ("view graph.g2o", "solve graph.g2o -o out.g2o --view page.html"):
        assert shell.refused(words).endswith('is missing; install it with pip install "leadline[view]"\n')
    with pytest.raises(nls.OptionError, match="the package plotly"):
        nls.plot.view(FactorGraph([]), Values())
