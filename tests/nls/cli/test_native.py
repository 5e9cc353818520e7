"""Every command reads and writes native files; of a folder it takes the graph in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
import sim
from tests.nls.cli.shell import Shell

WORLDS: dict[str, Callable[[], Any]] = {
    "ring": lambda: sim.ring(np.random.default_rng(0), laps=2, per_lap=15),
    "hauv": lambda: sim.hauv_floor(np.random.default_rng(0), legs=2, per_leg=5),
    "subsea": lambda: sim.subsea(np.random.default_rng(0), laps=1),
    "rig": lambda: sim.rig(np.random.default_rng(0), poses=4, points=20),
}


@pytest.mark.parametrize(("name", "form"), [*zip(WORLDS, ["npz", "json"] * 2, strict=True)])
def test_every_command_takes_it(name: str, form: str, shell: Shell) -> None:
    world = WORLDS[name]()
    file = f"world.{form}"
    nls.save(file, world.graph, world.start)
    best = world.graph.optimize(world.start).chi2_final
    info, solved = (
        shell.report(f"info {file}"),
        shell.report(f"solve {file} -o solved.{form} --report a.html --plot a.png"),
    )
    assert info["chi2"] == world.graph.chi2(world.start)
    assert solved["chi2_final"] == pytest.approx(best, rel=1e-6)
    graph, values, _ = nls.load(f"solved.{form}")
    assert graph.chi2(values) == solved["chi2_final"]
    assert Path("a.html").read_text().startswith("<!DOCTYPE html>")
    assert shell.report(f"explain {file}")["chi2"] > 0
    shell(f"plot {file} b.png")
    shell(f"convert {file} again.npz")
    assert nls.load("again.npz")[0].chi2(world.start) == world.graph.chi2(world.start)


@pytest.mark.parametrize("name", ["ring", "hauv", "subsea"])
def test_a_stream_ends_at_the_optimum(name: str, shell: Shell) -> None:
    world = WORLDS[name]()
    nls.save("world.npz", world.graph, world.start)
    lines = [json.loads(line) for line in shell("stream world.npz").splitlines()]
    graph, values = world.graph, world.start
    best = graph.optimize(nls.initialize(graph, values)[0]).chi2_final
    assert lines[-1]["chi2"] - best <= 1e-3 * max(best, 1.0) * 1.01
    assert "waiting" not in lines[-1]
    assert [line["step"] for line in lines] == list(range(1, len(lines) + 1))


def test_certify_and_a_folder(shell: Shell) -> None:
    world = WORLDS["ring"]()
    Path("demo").mkdir()
    nls.save("demo/graph.g2o", world.graph, world.truth)
    assert "demo/graph.g2o" in shell("solve demo")
    nls.save("demo/graph.npz", world.graph, world.start)
    out = shell("solve demo --certify")
    assert "input       demo/graph.npz" in out
    assert "certificate certified" in out
    assert nls.load("demo")[0].chi2(world.start) == world.graph.chi2(world.start)
    Path("empty").mkdir()
    assert "no mission" in shell.refused("solve empty")


def test_several_held_variables_and_damage_are_one_line(shell: Shell) -> None:
    world = WORLDS["ring"]()
    graph = nls.FactorGraph(world.graph.factors, [nls.kinds("x")[0][:3]])
    nls.save("held.npz", graph, world.start)
    assert "holds 3 variables; a stream holds the pose it begins with" in shell.refused("stream held.npz")
    Path("held.npz").write_bytes(Path("held.npz").read_bytes()[:900])
    for command in ("solve", "explain", "info", "stream"):
        assert "held.npz: is a damaged npz file" in shell.refused(f"{command} held.npz")
