"""Options of ``nls solve`` that change the problem: kernels, gnc, estimated sigmas, methods, what is held."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import BundleProjection, Cauchy, Huber, Isotropic
from factors.bundle import CAMERA, LENS
from factors.rescaled import rescaled
from models import R
from nls.missions.folder.write import write_mission
from tests.nls.cli.shell import CHORDS, RING, SPOILED, Shell, rows
from tests.nls.io.g2o_files import INFORMATION_2, PLANE
from tests.nls.missions.folder.mission_files import TINY, folder
from tests.nls.robust.test_graduated import names, wrong_closures

OUTLIER = PLANE + f"EDGE_SE2 1 3 5 5 0 {INFORMATION_2}\n"


def bundle(path: Path) -> str:
    """Three cameras see five points, with a pixel of error."""
    rng = np.random.default_rng(4)
    camera = np.column_stack([0.1 * rng.normal(size=(3, 3)), [[0, 0, -10], [1, 0, -10], [0, 1, -11]]])
    lens, point = np.tile([500.0, 0.0, 0.0], (3, 1)), 2 * rng.normal(size=(5, 3))
    c, k, l = nls.kinds("c", "k", "l")
    values = nls.Values({c: (CAMERA, camera), k: (LENS, lens), l: (R(3), point)})
    i, j = np.repeat(np.arange(3), 5), np.tile(np.arange(5), 3)
    blank = BundleProjection(c[i], k[i], l[j], np.zeros((15, 2)), Isotropic(1))
    model, X = values.gather(blank)
    z = blank.predict(model.manifolds, *X)[0] + rng.normal(size=(15, 2))
    start = values.replaced({"l": point + 0.1 * rng.normal(size=(5, 3))})
    nls.save(path, nls.FactorGraph([BundleProjection(c[i], k[i], l[j], z, Isotropic(1))]), start, dialect="bal")
    return path.name


def test_a_robust_kernel_on_every_factor(shell: Shell) -> None:
    plain = shell.report(f"solve {shell.file(OUTLIER)}", 1)
    robust = shell.report("solve graph.g2o --robust huber:1.5 -o out.g2o --allow-doubtful")
    assert (plain["robust"], robust["robust"]) == (None, "huber:1.5")
    graph, values, _ = nls.load("graph.g2o")
    graph = nls.FactorGraph([f.robust(Huber(1.5)) for f in graph.factors])
    expected = graph.optimize(nls.initialize(graph, values)[0])
    assert robust["chi2_final"] == expected.chi2_final < plain["chi2_final"]
    assert np.array_equal(nls.load("out.g2o")[1][nls.Kind("x")], expected.values[nls.Kind("x")])
    assert "expected), robust kernel cauchy:2" in shell("solve graph.g2o --robust cauchy:2 --allow-doubtful")
    short, long = (shell(f"solve graph.g2o --robust huber{c} --allow-doubtful") for c in ("", ":1.345"))
    assert "--robust huber: taken as huber:1.345, 95 % efficient without outliers" in rows(short, "note")
    assert rows(short, "result") == rows(long, "result")


def test_a_method_that_failed_is_in_the_report(shell: Shell) -> None:
    """Gauss-Newton cycles where one measurement contradicts all others; another method goes on."""
    report = shell.report(f"solve {shell.file(PLANE + f'EDGE_SE2 1 3 30 5 0.5 {INFORMATION_2}')} --init file", 1)
    (attempt,) = report["attempts"]
    assert (report["status"], attempt["method"], attempt["status"]) == ("CONVERGED", "gauss-newton", "CYCLING")
    assert set(attempt) == {"method", "status", "reason", "iterations"}


def test_a_kernel_on_one_type_of_factor(shell: Shell) -> None:
    folder(shell / "m", contacts=TINY["contacts"].replace("2,12,4.2289", "2,12,4.4289"))
    report = shell.report("solve m --robust RangeAzimuth=cauchy:1 --init odometry")
    assert report["robust"] == "RangeAzimuth=cauchy:1"
    graph, values, _ = nls.load("m")
    graph.factors = [f.robust(Cauchy(1.0)) if f.name == "RangeAzimuth" else f for f in graph.factors]
    expected = graph.optimize(nls.initialize(graph, values, "odometry")[0])
    assert report["chi2_final"] == expected.chi2_final
    every = shell.report("solve m --robust cauchy:1 --init odometry --allow-doubtful")
    assert every["chi2_final"] != report["chi2_final"]


def test_a_kind_is_held(shell: Shell) -> None:
    """Cameras and points keep their scale free, which a damped method does not notice by itself; held cameras not."""
    file = bundle(shell / "bundle.txt")
    free = shell.report(f"solve {file} --hold k")
    assert (free["method"], free["converged"]) == ("levenberg-marquardt", True)
    assert free["underconstrained"]
    report = shell.report(f"solve {file} --hold k --hold c -o out.txt --to bal")
    assert (report["held"], report["gauge"]) == (["k", "c"], "fixed by the graph itself")
    assert (list(report["starts"]), report["dof"], report["underconstrained"]) == (["file"], 30 - 15, [])
    before, after = nls.load(file)[1], nls.load("out.txt")[1]
    assert [np.array_equal(after[kind], before[kind]) for kind in nls.kinds("c", "k", "l")] == [True, True, False]
    assert rows(shell(f"solve {file} --hold k"), "fixed") == ["all k"]


def test_what_a_file_holds_fixed_is_held_and_the_rest_not_written_as_fixed(shell: Shell) -> None:
    shell.file(PLANE + "FIX 2\n")
    for command in ("solve", "explain"):
        assert "gauge: fixed by the graph itself" in shell(f"{command} graph.g2o")
    assert shell("solve graph.g2o --hold x -o out.g2o --quiet --allow-doubtful") == ""
    assert [repr(keys) for keys in nls.load("out.g2o")[0].fixed] == ["x2"]


def test_how_lines_read_is_named(shell: Shell) -> None:
    lines = [f"EDGE2 {k} {k + 1} 1 0 0.1 100 0 50 200 0 0" for k in range(3)]
    shell.file("\n".join([*lines, "EDGE2 0 3 3 0.6 0.2 100 0 50 200 0 0"]), "a.txt")
    for command in ("solve", "info"):
        assert shell.report(f"{command} a.txt --dialect toro")["format"] == "toro"


@pytest.mark.filterwarnings("always")
def test_negative_information_is_repaired_on_request(shell: Shell) -> None:
    shell.file(PLANE + "EDGE_SE2 1 3 0 2 3 500 0 0 400 0 -3\n")
    for command in ("solve", "info"):
        _, err = shell.both(f"{command} graph.g2o --repair-information")
        assert err.startswith("nls: warning: ")
        assert err.count("\n") == 1


@pytest.mark.filterwarnings("always")
def test_lines_are_left_out_as_the_refusals_advise(shell: Shell) -> None:
    """Followed to the letter, by every command that reads a graph."""
    shell.file(PLANE + "EDGE_A,B$x 1 2\n", "tags.g2o")
    shell.file(PLANE + "EDGE_SE2 3 77 1 0 0 1 0 0 1 0 1\n", "absent.g2o")
    for name in ("tags.g2o", "absent.g2o"):
        for command in ("solve {}", "explain {}", "info {}", "convert {} b.g2o", "plot {} b.png", "stream {}"):
            words = command.format(name)
            if words == "stream absent.g2o":  # which makes a variable where an edge names it
                continue
            cure = shell.refused(words).splitlines()[-1].split(" out: ")[1]
            _, err = shell.both(f"{words} {cure}")
            assert re.search(
                r"warning: .*(EDGE_A,B\$x \(1, first on line 9|1 edge to .* left out, first on line 9)", err
            )


def too_sure(path: Path) -> None:
    """A file of three laps of a ring of poses that states a third of the sigmas of its errors."""
    world = sim.ring(np.random.default_rng(0), laps=3, per_lap=20)
    models = [world.start.gather(factor)[0] for factor in world.graph.factors]
    nls.save(path, nls.FactorGraph([rescaled(model, np.full((1, model.dim), 1 / 3)) for model in models]), world.start)


def test_the_table_has_a_row_a_kind_and_files_the_estimated_sigmas(shell: Shell) -> None:
    too_sure(shell / "graph.g2o")
    report = shell.report("solve graph.g2o --sigmas estimate -o solved.g2o --covariance c.csv")
    kinds = report["sigmas"]["kinds"]
    assert [kind["kind"] for kind in kinds] == ["Between, steps", "Between, closures"]
    assert all(abs(kind["scale"] - 3) < 3 * kind["scale_sigma"] for kind in kinds)
    assert "solved.g2o holds the estimated sigmas, not the stated ones" in report["notes"]
    again = shell.report("solve solved.g2o --init file")
    assert again["chi2_final"] == pytest.approx(report["chi2_final"], rel=1e-5)
    assert report["chi2_final"] == pytest.approx(report["dof"], rel=0.01)
    stated = shell("solve graph.g2o --covariance stated.csv --allow-doubtful")
    assert not rows(stated, "sigmas")
    ratio = largest(shell / "c.csv") / largest(shell / "stated.csv")
    assert 2.5**2 < ratio < 3.5**2
    table = rows(shell("solve graph.g2o --sigmas estimate:units"), "sigmas")
    assert [row.split(": stated")[0] for row in table][:2] == ["Between, steps: x, y", "Between, steps: yaw"]


def largest(path: Path) -> float:
    """Largest number of a file of covariances."""
    text = path.read_text().splitlines()
    return max(float(word) for line in text[1:] for word in line.split(",")[-6:] if word[:1].isdigit())


def test_a_kernel_and_a_chain_that_nothing_checks(shell: Shell) -> None:
    shell.file(SPOILED)
    out, _ = shell.both("solve graph.g2o --sigmas estimate --robust cauchy:2")
    assert len(rows(out, "sigmas")) == 2
    shell.file("\n".join(RING.splitlines()[:5]) + "\n")
    (row,) = rows(shell("solve graph.g2o --sigmas estimate"), "sigmas")
    assert row == "Between: stated sigmas kept, no other measurement checks them (redundancy 0 of 15 numbers)"


def test_a_mission_has_the_sigmas_of_the_estimated_noise(shell: Shell, undrawn: None) -> None:
    mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=6)
    write_mission(shell / "m", mission.graph, mission.sonar, mission.offset, mission.truth)
    report = shell.report("solve m --sigmas estimate -o out")
    assert report["sigmas"]["settled"]
    known = [kind for kind in report["sigmas"]["kinds"] if kind["known"]]
    assert len(known) >= 2
    assert all(abs(np.log(k["scale"])) < 4 * k["scale_sigma"] / k["scale"] + 0.1 for k in known)
    assert (shell / "out" / "trajectory.csv").exists()


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str]]:
    """A city with twenty wrong closures in two groups, and their names."""
    world = sim.manhattan(np.random.default_rng(3), n_poses=300)
    wrong = wrong_closures(world, 20, np.random.default_rng(4), 10)
    path = tmp_path_factory.mktemp("spoiled") / "city.g2o"
    nls.save(path, nls.FactorGraph([*world.graph.factors, wrong]), world.truth)
    return path, names(wrong)


def test_the_advice_on_a_wrong_closure_rejects_that_closure(shell: Shell) -> None:
    (advice,) = re.findall(r"-> find wrong loop closures: nls solve (.*)", shell(f"explain {shell.file(SPOILED)}"))
    assert [each["line"] for each in shell.report(f"solve graph.g2o {advice}")["rejected"]] == [15]
    clean = shell.file(RING + CHORDS, "clean.g2o")
    assert "wrong" not in shell(f"explain {clean}")
    assert shell.report(f"solve {clean} {advice}")["rejected"] == []


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
    graph, values, _ = nls.load(path)
    assert record["chi2_file"] == graph.chi2(values)  # of all
    assert f"{record['chi2_final']:.9g} by the choice of gnc-tls and " in out
    assert (record["init"], record["certificate"]["verdict"]) == ("gnc-tls", "certified")
    assert f"{len(rejected)} of {record['doubted']} tested measurements rejected" in out
    assert f"rejected, {len(wrong)} of them far off, by up to" in out
    assert record["rejected"][0]["factor"] in out
    assert f"out.g2o leaves out {len(rejected)} rejected measurements" in out
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
