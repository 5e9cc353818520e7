"""The house rules that can be read off the sources: who imports whom, what the engine may name, what is documented."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path
from types import ModuleType

import pytest

import factors
import models
import nls
import sim

ROOT = Path(__file__).parents[1]
PACKAGES = ("models", "factors", "nls", "sim")
RIM = (
    "analysis",
    "robust",
    "io",
    "starts",
    "inspect",
    "plot",
    "cli",
    "filters",
    "analysis",
    "sonar",
    "certificate",
    "analysis",
    "explanation",
    "__main__",
)
# The floor of the engine, from the ground up: which rooms each imports, late and typing imports counted.
FLOOR = {
    "values": set(),
    "sparse": {"values"},
    "system": {"sparse", "values"},
    "gauge": {"sparse", "values"},
    "linear": {"gauge", "sparse", "system", "values"},
    "optimizers": {"linear", "sparse", "system", "values"},
    "graph": {"gauge", "linear", "optimizers", "sparse", "system", "values"},
}
CIRCLES = [  # files that import each other; none may be added
    {"models.manifolds.euler", "models.manifolds.se3"},
    {"nls.explanation.findings", "nls.explanation.words"},
    {"factors.base", "factors.differences", "factors.function", "factors.return_values"},
]
ENGINE = (*FLOOR, "covariance")
FACTORS_FOR_ENGINE = {"base", "noise", "keys", "prior", "check", "robust"}
ALLOWED = {"models": set(), "factors": {"models"}, "nls": {"models", "factors"}, "sim": {"models", "factors", "nls"}}
ONLY_IN = {"sksparse": {"nls/linear/cholesky.py"}, "sparseqr": {"nls/linear/qr.py"}}
SPACES = {"SE2", "SE3", "SO2", "SO3", "PosesOfThePlane", "PosesOfSpace", "rotation2", "rotation3"}
SENSORS = {"Between", "Range", "Bearing", "BearingRange", "Sonar", "Camera", "Depth", "DVL", "USBL", "Projection"}

NO_NAMES = {"found", "said", "each", "told", "what", "seen"}  # a name is a noun of the thing or a verb of the act
OLD_NAMES_IN = ("analysis", "certificate", "explanation", "robust", "starts", "track.py")  # of nls: still to be renamed

FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def name_of(path: Path) -> str:
    """Path from the root, with slashes."""
    return path.relative_to(ROOT).as_posix()


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> set[str]:
    """Dotted names of everything a file imports, also inside functions; ``from a import b`` gives a and a.b."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name_of(path)}:{node.lineno}: relative import"
            found |= {str(node.module)} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def engine_files() -> list[Path]:
    return [
        p
        for p in FILES
        if p.parts[len(ROOT.parts)] == "nls" and p.relative_to(ROOT / "nls").parts[0].removesuffix(".py") in ENGINE
    ]


def modules() -> list[ModuleType]:
    out: list[ModuleType] = []
    for package in (models, factors, nls, sim):
        out.append(package)
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if not found.name.endswith("__main__"):
                out.append(importlib.import_module(found.name))
    return out


def test_there_is_something_to_look_at() -> None:
    assert len(FILES) > 40
    assert {name.split("/")[1].removesuffix(".py") for name in map(name_of, engine_files())} == set(ENGINE)


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_imports_go_one_way(path: Path) -> None:
    package = name_of(path).split("/")[0]
    ours = {name.split(".")[0] for name in imports(path)} & set(PACKAGES)
    assert ours - {package} <= ALLOWED[package]
    assert not {name.split(".")[0] for name in imports(path)} & {"tests", "benchmarks", "docs"}


@pytest.mark.parametrize("path", engine_files(), ids=name_of)
def test_the_engine_does_not_know_the_rim(path: Path) -> None:
    for name in imports(path):
        parts = name.split(".")
        if parts[0] == "nls" and len(parts) > 1:
            assert parts[1] not in RIM, f"{name_of(path)} imports {name}"
        if parts[0] == "factors" and len(parts) > 1:
            assert parts[1] in FACTORS_FOR_ENGINE, f"{name_of(path)} imports {name}"


@pytest.mark.parametrize("room", FLOOR)
def test_a_room_of_the_floor_imports_what_lies_below_it(room: str) -> None:
    """Both ways: nothing else, and all of that. So no import has to hide in a function."""
    rooms = list(FLOOR)
    assert all(rooms.index(below) < rooms.index(room) for below in FLOOR[room])
    files = [p for p in engine_files() if p.relative_to(ROOT / "nls").parts[0].removesuffix(".py") == room]
    found = {name.split(".")[1] for path in files for name in imports(path) if name.startswith("nls.")}
    assert found - {room} == FLOOR[room]
    for path in files:
        for function in (node for node in ast.walk(tree_of(path)) if isinstance(node, ast.FunctionDef)):
            for node in ast.walk(function):
                module = str(node.module) if isinstance(node, ast.ImportFrom) else ""
                assert module.split(".")[0] not in PACKAGES, f"{name_of(path)}:{function.lineno} imports {module} late"


def test_no_further_files_import_each_other() -> None:
    modules_of = {name_of(path).removesuffix(".py").removesuffix("/__init__").replace("/", "."): path for path in FILES}
    below: dict[str, set[str]] = {}
    for module, path in modules_of.items():
        named = {next((n for n in (name, name.rpartition(".")[0]) if n in modules_of), "") for name in imports(path)}
        packages = {
            name for name in named if any(other.startswith(name + ".") for other in named)
        }  # of what is in them
        below[module] = named - {module, ""} - packages

    def reached(module: str) -> set[str]:
        out, waiting = set(), [module]
        while waiting:
            for other in below[waiting.pop()] - out:
                out.add(other)
                waiting.append(other)
        return out

    above = {module: reached(module) for module in modules_of}
    circles = {frozenset(other for other in above[m] if m in above[other]) for m in modules_of if m in above[m]}
    assert circles == set(map(frozenset, CIRCLES))


@pytest.mark.parametrize("path", engine_files(), ids=name_of)
def test_the_engine_names_no_space_and_no_sensor(path: Path) -> None:
    for node in ast.walk(tree_of(path)):
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else None
        if isinstance(node, ast.ImportFrom):
            assert not {alias.name for alias in node.names} & (SPACES | SENSORS), name_of(path)
        assert name not in SPACES | SENSORS, f"{name_of(path)} names {name}"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_optional_packages_have_one_door(path: Path) -> None:
    top = {name.split(".")[0] for name in imports(path)}
    for package, where in ONLY_IN.items():
        assert package not in top or name_of(path) in where
    if "matplotlib" in top or "mpl_toolkits" in top:
        assert "plot" in path.parent.parts or path.name == "plot.py"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_slow_packages_are_imported_where_they_are_used(path: Path) -> None:
    checked = ast.Module([n for n in tree_of(path).body if isinstance(n, ast.Import | ast.ImportFrom)], [])
    for node in checked.body:
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else [str(node.module)]  # type: ignore[attr-defined]
        assert not {n.split(".")[0] for n in names} & {
            "matplotlib",
            "mpl_toolkits",
            "tqdm",
            "threadpoolctl",
            "sksparse",
            "sparseqr",
        }
        assert not {n for n in names if n.startswith("scipy.sparse.linalg")}


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_files_are_short_and_say_what_they_are(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 400
    assert ast.get_docstring(ast.parse(text)), f"{name_of(path)} has no docstring"


@pytest.mark.parametrize("module", modules(), ids=lambda m: m.__name__)
def test_public_names_exist_and_are_documented(module: ModuleType) -> None:
    public = getattr(module, "__all__", [])
    assert len(set(public)) == len(public)
    for name in public:
        thing = getattr(module, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert inspect.getdoc(thing), f"{module.__name__}.{name} has no docstring"
        if inspect.isclass(thing) and module in (models, factors, nls, sim):
            for member, value in vars(thing).items():
                if not member.startswith("_") and inspect.isfunction(value):
                    assert inspect.getdoc(getattr(thing, member)), f"{module.__name__}.{name}.{member} has no docstring"


@pytest.mark.parametrize("package", [models, factors, nls, sim], ids=lambda m: m.__name__)
def test_packages_state_their_public_names(package: ModuleType) -> None:
    assert package.__all__
    assert package.__doc__


def names_given_in(path: Path) -> set[str]:
    """Names that a file gives to variables, arguments, attributes and functions, without leading underscores."""
    names = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
    return {name.strip("_").lower() for name in names}


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_names_are_nouns_and_verbs(path: Path) -> None:
    parts = path.relative_to(ROOT).parts
    if parts[0] == "nls" and parts[1] in OLD_NAMES_IN:
        pytest.skip("still to be renamed")
    assert not names_given_in(path) & NO_NAMES, name_of(path)


def test_tests_are_short_too() -> None:
    long = {name_of(p): n for p in (ROOT / "tests").rglob("*.py") if (n := len(p.read_text().splitlines())) > 400}
    assert long == {}
