"""What a process pays before its work: imports when they are used, one thread, no file rendered twice."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import factors
import nls
import sim
from nls.cli import THREADS, choices, main
from nls.io import write
from nls.stages import collected, stage
from tests.nls.io.g2o_files import PLANE
from tests.nls.io.g2o_files import write as written

ROOT = Path(__file__).parents[2]


def fresh(program: str, **environment: str | None) -> str:
    """Standard output of a program in a process of its own; None takes a variable out of its environment."""
    everything: dict[str, str | None] = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        env={name: value for name, value in everything.items() if value is not None},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("package", [factors, nls, sim], ids=lambda package: package.__name__)
def test_names_come_from_where_the_type_checker_thinks(package: ModuleType) -> None:
    tree = ast.parse((ROOT / package.__name__ / "__init__.py").read_text(encoding="utf-8"))
    (checked,) = [node for node in tree.body if isinstance(node, ast.If) and isinstance(node.test, ast.Name)]
    lines = [node for node in checked.body if isinstance(node, ast.ImportFrom)]
    pairs = [(str(node.module), alias.name) for node in lines for alias in node.names]
    said = {n: m for m, name in pairs for n in (import_module(m).__all__ if name == "*" else [name])}
    modules = {name for name, module in said.items() if module == package.__name__}
    said = {name: module for name, module in said.items() if name not in modules}
    assert said == {name: module for module, names in package._WHERE.items() for name in names.split()}
    assert set(package.__all__) == {*said, *modules}
    for name, module in said.items():
        assert getattr(package, name) is getattr(sys.modules[str(module)], name)
    assert set(package.__all__) <= set(dir(package))


def test_only_what_is_used_is_imported() -> None:
    assert fresh("import nls, sys; print([m for m in ('numpy', 'nls.graph') if m in sys.modules])") == "[]\n"
    assert fresh("import sim.process, sys; print([m for m in ('numpy', 'typing') if m in sys.modules])") == "[]\n"
    used = "nls.Values, nls.FactorGraph, nls.load"
    rest = ("nls.covariance", "nls.plot", "nls.io.bal", "nls.io.pyfg", "nls.analysis", "matplotlib", "threadpoolctl")
    assert fresh(f"import nls, sys; {used}; print([m for m in {rest} if m in sys.modules])") == "[]\n"
    assert fresh("from nls import *; print(FactorGraph.__module__, plot.__name__)") == "nls.graph nls.plot\n"


@pytest.mark.parametrize("words", ["--help", "solve --help", ""])
def test_help_does_not_wait_for_numpy(words: str) -> None:
    program = f"import sys\nfrom nls.cli import main\nmain({words.split()})\nprint('numpy' in sys.modules)"
    *page, loaded = fresh(program).splitlines()
    assert len(page) > 20
    assert loaded == "False"


def test_the_choices_of_the_command_line_are_those_of_the_library() -> None:
    from factors import conventions, robust, sonar_factors
    from nls import gauge, linear, metrics, optimizers, starts
    from nls.cli.outliers import PREFIX
    from nls.robust.kernels import LOSSES

    assert (choices.ALIGNMENTS, choices.GAUGES) == (metrics.ALIGNMENTS, gauge.GAUGES)
    assert choices.CONVENTIONS == conventions.CONVENTIONS
    registries = linear.SOLVERS, optimizers.OPTIMIZERS, starts.STARTS
    assert (choices.SOLVERS, choices.OPTIMIZERS, choices.STARTS) == tuple(map(tuple, registries))
    assert (choices.KERNELS, choices.GNC) == (tuple(robust.KERNELS), tuple(f"{PREFIX}{loss}" for loss in LOSSES))
    assert all(f"``{name}``" in str(sonar_factors.__doc__) for name in choices.TREATMENTS)


def test_a_plain_graph_is_solved_without_the_rooms_of_missions(tmp_path: Path) -> None:
    """Without modules of NumPy that only ``from numpy import *`` asks for; a small one without sparse matrices."""
    graph = str(written(tmp_path, PLANE))
    rest: tuple[str, ...] = ("scipy.linalg", "scipy.special", "numpy.f2py.f2py2e", "nls.missions", "nls.robust")
    rest += ("factors.wheels", "factors.dvl_leg", "models.vehicles", "nls.plot.report", "nls.cli.outliers")
    rest += ("scipy.sparse._base", "sksparse.cholmod")
    program = (
        f"import sys\nfrom nls.cli import main\nprint(main(['solve', {graph!r}, '--quiet']))\n"
        f"print([m for m in {rest} if m in sys.modules])\nimport numpy\n"
        "print(numpy.ma.array([1, 2], mask=[0, 1]).sum(), numpy.polynomial.Polynomial([1, 2])(3))"
    )
    assert fresh(program).splitlines() == ["0", "[]", "1 7.0"]
    with_numpy = f"import numpy\nfrom nls.lazy import postpone\npostpone('numpy', ['f2py'])\n{program}"
    assert fresh(with_numpy).splitlines()[0] == "0"


@pytest.mark.parametrize(
    ("words", "whose"),
    [
        ("", ""),
        ("--robust cauchy", ""),
        ("--linear-solver lu --init odometry", ""),
        ("--robust gnc-tls", "nls."),
        ("--sigmas estimate", "nls."),
    ],
)
def test_imports_are_counted_as_imports(words: str, whose: str, tmp_path: Path) -> None:
    """No module is loaded while a graph is read, started and solved: their clocks say what the work takes."""
    steps = [(k, k + 1, "1 0 0.1") for k in range(62)] + [(k, k + 60, "0 0 0") for k in range(3)]  # 189 columns
    lines = [f"EDGE_SE2 {i} {j} {z} 9 0 0 9 0 9" for i, j, z in steps]
    (tmp_path / "circle.g2o").write_text("\n".join(lines))
    program = f"""
import sys
from nls.cli import main
from nls.cli.run import Clock
late, known, lap = dict(), set(), Clock.lap
def counted(clock, name):
    late[name] = late.get(name, set()) | set(sys.modules) - known
    known.update(sys.modules)
    lap(clock, name)
Clock.lap = counted
main(["solve", {str(tmp_path / "circle.g2o")!r}, "--quiet", "--allow-doubtful", *{words.split()}])
print(sorted(late))
print([name for stage in ("read", "init", "optimize") for name in late[stage] if name.startswith({whose!r})])
"""
    assert fresh(program).splitlines() == [str(["check", "imports", "init", "optimize", "read", "write"]), "[]"]


def test_modules_of_the_package_are_there_without_an_import_of_theirs() -> None:
    assert fresh("import nls; print(nls.linear.SOLVERS['lu'].name, nls.io.load is nls.load)") == "lu True\n"
    with pytest.raises(AttributeError, match="module 'nls' has no attribute 'nothing'"):
        nls.nothing  # type: ignore[attr-defined]  # noqa: B018
    assert not hasattr(nls, "_nothing")


@pytest.mark.parametrize("given", [None, "3"])
def test_the_command_line_has_one_thread_unless_told_otherwise(given: str | None) -> None:
    program = (
        "import gc, os, sys\nfrom nls.cli import command\nassert 'numpy' not in sys.modules\n"
        "sys.argv = ['nls', '--version']\ncommand()\nassert gc.get_freeze_count() > 1000\n"
        "assert gc.get_stats()[0]['collections'] < 30\n"
        f"print([os.environ[name] for name in {THREADS}])"
    )
    expected = str([given or "1"] * len(THREADS))
    assert fresh(program, **dict.fromkeys(THREADS, given)).splitlines()[-1] == expected


def test_the_output_is_written_once_as_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check before the work makes no text: it is a tenth of writing it."""
    calls: list[bytes] = []
    lines = write._lines

    def counted(tag: bytes, *rest: object) -> list[str]:
        calls.append(tag)
        return lines(tag, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(write, "_lines", counted)
    out = tmp_path / "out.g2o"
    assert main(["solve", str(written(tmp_path, PLANE)), "-o", str(out), "--quiet"]) == 0
    assert len(calls) == len(set(calls)) > 1
    assert all(out.read_text().count(tag.decode() + " ") for tag in calls)


def test_the_check_refuses_what_writing_refuses(tmp_path: Path) -> None:
    """A graph for each reason there is, in every format: the same words, before and after."""
    from factors import Between, Cauchy, Factor, Information, Isotropic, Prior, Range
    from models import SE2, SE3, R
    from nls.cli.formats import refuse_unwritable_graph, rendered

    x, y, l = nls.kinds("x", "y", "l")
    step, poses = Between(x[0], x[1], [1, 0, 0], Isotropic(1)), {x: (SE2, np.zeros((2, 3)))}
    point, up = {l: (R(2), [[1.0, 0.0]], [5])}, np.array([[0, 0, 0, 0, np.sqrt(0.5), 0, np.sqrt(0.5)]] * 2)
    cases: list[tuple[list[Factor], dict[nls.Kind, Any]]] = [
        ([step], poses),
        ([step.robust(Cauchy(1.0))], poses),
        ([step, Range(x[0], l[5], 1.0, Isotropic(1))], poses | point),
        ([step, Prior(l[5], [1, 0], Isotropic(1))], poses | point),
        ([step], poses | {l: (R(2), [[1.0, 0.0]], [1])}),
        ([step], poses | {y: (R(1), [[1.0]], [5])}),
        ([Between(x[0], x[1], [1, 0, 0], Information(np.diag([1.0, 1.0, 0.0])))], poses),
        ([step, Between(x[0], x[1], [1, 0, 0], Isotropic(1), convention="g2o")], poses),
        ([Between(x[0], x[1], up[0], Isotropic(1))], {x: (SE3, SE3.identity(2))}),  # at gimbal lock
        ([Between(x[0], x[1], SE3.identity(), Isotropic(2))], {x: (SE3, up)}),
    ]
    graphs = [(nls.FactorGraph(factors), values) for factors, values in cases]
    graphs.append((nls.FactorGraph([step], [x[0]]), poses))
    for form in ("g2o", "toro", "isam", "isam-covariance", "graph"):
        reasons = []
        for graph, given in graphs:
            values, report = nls.Values(given), nls.LoadReport("in", "npz", "2-D", "log")
            job = str(tmp_path / "out"), form, graph, values, report
            before, after = refusal(refuse_unwritable_graph, *job), refusal(rendered, *job)
            assert before == after
            reasons.append(before)
        assert reasons[1]
        assert len(set(reasons) - {""}) >= 4
        assert "" in reasons


def refusal(job: Callable[..., object], *arguments: object) -> str:
    """The words of a refusal; none for a job that is done."""
    try:
        job(*arguments)
    except nls.GraphError as error:
        return str(error)
    return ""


def test_stages_are_counted_where_somebody_collects_them() -> None:
    with stage("nobody"), collected() as outer:
        with stage("a"), collected() as inner, stage("b"):
            pass
        with pytest.raises(ZeroDivisionError), stage("failed"):
            raise ZeroDivisionError
        with stage("a"):
            first = outer["a"]
    assert (set(outer), set(inner)) == ({"a", "failed"}, {"b"})
    assert outer["a"] > first > 0
