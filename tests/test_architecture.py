"""The rules of the house that can be read off the sources. Each test names every file that breaks its rule."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import factors
import models
import nls
import sim

ROOT = Path(__file__).parents[1]
PACKAGES = ("models", "factors", "nls", "sim")
RIM = {"posegraph", "analysis", "robust", "io", "starts", "plot", "cli", "filters", "sonar", "missions", "certificate"}
RIM |= {"explanation", "__main__"}
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
# On the floor, under the other rooms of the rim. It knows sensors, so it is no room of the engine.
ROOMS = FLOOR | {"posegraph": {"gauge", "graph", "sparse", "values"}}
CIRCLES = [  # files that import each other; none may be added
    {"models.manifolds.euler", "models.manifolds.se3"},
    {"nls.explanation.findings", "nls.explanation.words"},
    {"factors.base", "factors.function"},  # `Factor.from_function` makes one of its subclasses
]
ENGINE = (*FLOOR, "covariance")
OF_ALL = {"lazy", "stages"}  # modules of the root that every room may import
FACTORS_FOR_ENGINE = {"base", "check", "joined", "keys", "noise", "prior", "robust"}
ALLOWED = {"models": set(), "factors": {"models"}, "nls": {"models", "factors"}, "sim": {"models", "factors", "nls"}}
SHADOWS = ("factors/__init__.py", "nls.lazy")  # the upward import that refuses shadows; it imports nothing of ours
ONLY_IN = {
    "sksparse": {"nls/linear/cholesky.py"},
    "sparseqr": {"nls/linear/qr.py"},
    "pyproj": {"nls/missions/charts/chart.py"},
    "plotly": {"nls/plot/view.py"},
    "argcomplete": {"nls/cli/__init__.py"},
}
NO_NAMES = {"found", "said", "each", "told", "what", "seen"}  # a name is a noun of the thing or a verb of the act
SLOW = {
    "matplotlib",
    "mpl_toolkits",
    "tqdm",
    "threadpoolctl",
    "sksparse",
    "sparseqr",
    "pyproj",
    "plotly",
    "argcomplete",
}  # to import: only where used
SPACES = {"SE2", "SE3", "SO2", "SO3", "PosesOfThePlane", "PosesOfSpace", "rotation2", "rotation3"}
SENSORS = {"Between", "Range", "Bearing", "BearingRange", "Sonar", "Camera", "Depth", "DVL", "USBL", "Projection"}

FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


@cache
def tree_of(path: Path) -> ast.Module:
    """Syntax tree of a file, read when a test wants it: a process that runs other tests needs none."""
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path: Path) -> str:
    """Path from the root, with slashes."""
    return path.relative_to(ROOT).as_posix()


def imported(node: ast.AST) -> set[str]:
    """Dotted names that a statement imports; ``from a import b`` gives a and a.b."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        return {str(node.module)} | {f"{node.module}.{alias.name}" for alias in node.names}
    return set()


@cache
def imports_of(path: Path) -> set[str]:
    """Dotted names that a file imports, late ones, too."""
    return set().union(*map(imported, ast.walk(tree_of(path))))


def top(names: set[str]) -> set[str]:
    return {name.split(".")[0] for name in names}


def room_of(path: Path) -> str:
    """Module or folder of `nls` that a file belongs to; its package elsewhere."""
    parts = path.relative_to(ROOT).parts
    return parts[1].removesuffix(".py") if parts[0] == "nls" else parts[0]


def engine_files() -> list[Path]:
    return [path for path in FILES if name_of(path).startswith("nls/") and room_of(path) in ENGINE]


def upward() -> Iterator[str]:
    """Imports that the packages, the engine and the rooms of its floor do not allow."""
    for path in FILES:
        package = name_of(path).split("/")[0]
        names = {name for name in imports_of(path) if (name_of(path), name) != SHADOWS}
        if others := (top(names) & {*PACKAGES, "tests", "benchmarks", "docs"}) - {package, *ALLOWED[package]}:
            yield f"{name_of(path)} imports {others}"
    for path in engine_files():
        for name in imports_of(path):
            package, _, rest = name.partition(".")
            module = rest.split(".")[0]
            if (package == "nls" and module in RIM) or (
                package == "factors" and module not in {"", *FACTORS_FOR_ENGINE}
            ):
                yield f"{name_of(path)} imports {name}"
    rooms = list(ROOMS)
    for room, below in ROOMS.items():
        files = [path for path in FILES if name_of(path).startswith("nls/") and room_of(path) == room]
        used = {name.split(".")[1] for path in files for name in imports_of(path) if name.startswith("nls.")} - {
            room,
            *OF_ALL,
        }
        if used != below or any(rooms.index(other) > rooms.index(room) for other in below):
            yield f"nls.{room} imports {used}, not {below}"
        for path in files:
            functions = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.FunctionDef)]
            late = set().union(*(imported(node) for function in functions for node in ast.walk(function)))
            if hidden := top(late) & set(PACKAGES):
                yield f"{name_of(path)} imports {hidden} inside a function"


def test_imports_go_one_way() -> None:
    """A room of the floor imports what the table says, and all of it, so that no import hides in a function."""
    assert {room_of(path) for path in engine_files()} == set(ENGINE)
    assert list(upward()) == []


def test_storeys_import_downward() -> None:
    """Those of `tools/rooms.py`. Missions are imported by the command line, the simulator and doors alone."""
    from tools.rooms import STOREYS

    storey_of = {room: k for k, inside in enumerate(STOREYS.values()) for room in inside}
    upward, visitors = [], []
    for path in (path for path in FILES if name_of(path).startswith(("nls/", "sim/"))):
        rooms = {name.split(".")[1] for name in imports_of(path) if name.startswith("nls.")}
        here = storey_of.get(room_of(path), 0)  # of users and of `sim`: above all
        upward += [f"{name_of(path)} imports {room}" for room in rooms if storey_of.get(room, 9) < here]
        visitors += [name_of(path)] * ("missions" in rooms and room_of(path) not in {"missions", "sonar", "cli", "sim"})
    assert upward == ["nls/plot/__init__.py imports missions"]  # pictures under their public path, when they are used
    assert visitors == ["nls/plot/__init__.py"]
    assert set(storey_of) == {room_of(path) for path in FILES if name_of(path).startswith("nls/")} - {
        "__init__",
        "__main__",
    }


def test_the_root_of_nls_holds_no_other_modules() -> None:
    of_users = {"gauge", "graph", "posegraph", "system", "values"}
    assert {path.stem for path in (ROOT / "nls").glob("*.py")} == {"__init__", "__main__", *of_users, *OF_ALL}


def test_no_further_files_import_each_other() -> None:
    modules_of = {name_of(path).removesuffix(".py").removesuffix("/__init__").replace("/", "."): path for path in FILES}
    below: dict[str, set[str]] = {}
    for module, path in modules_of.items():
        named = {next((n for n in (name, name.rpartition(".")[0]) if n in modules_of), "") for name in imports_of(path)}
        packages = {name for name in named if any(other.startswith(name + ".") for other in named)}  # of these
        below[module] = named - {module, ""} - packages

    def reached(module: str) -> set[str]:
        out: set[str] = set()
        waiting = [module]
        while waiting:
            for other in below[waiting.pop()] - out:
                out.add(other)
                waiting.append(other)
        return out

    above = {module: reached(module) for module in modules_of}
    circles = {frozenset(other for other in above[m] if m in above[other]) for m in modules_of if m in above[m]}
    assert circles == set(map(frozenset, CIRCLES))


def test_the_engine_names_no_space_and_no_sensor() -> None:
    def names(node: ast.AST) -> set[str]:
        if isinstance(node, ast.ImportFrom):
            return {alias.name for alias in node.names}
        return {getattr(node, "id", ""), getattr(node, "attr", "")}

    named = {path: set().union(*map(names, ast.walk(tree_of(path)))) & (SPACES | SENSORS) for path in engine_files()}
    assert {name_of(path): words for path, words in named.items() if words} == {}


def test_optional_and_slow_packages_have_one_door() -> None:
    def strays(path: Path) -> set[str]:
        at_start = set().union(*map(imported, tree_of(path).body))
        used = top(imports_of(path))
        out = {package for package, files in ONLY_IN.items() if package in used and name_of(path) not in files}
        out |= (
            used & {"matplotlib", "mpl_toolkits"}
            if not {"plot", "pictures"} & {*path.parent.parts, path.stem}
            else set()
        )
        scipy = {name for name in at_start if name.startswith("scipy")} - {"scipy", "scipy.sparse"}
        return out | (top(at_start) & SLOW) | scipy

    assert {name_of(path): names for path in FILES if (names := strays(path))} == {}


def test_only_the_inputs_ask_what_was_read() -> None:
    """The command line asks nowhere else for the class or the format of a report, or for the kind of a folder."""
    kinds = {"inputs", "graph_file", "mission", "scan_mission", "formats"}

    def asks(node: ast.AST) -> bool:
        if isinstance(node, ast.Compare):
            return any(getattr(side, "attr", "") == "format" for side in (node.left, *node.comparators))
        words = [getattr(part, "attr", getattr(part, "id", "")) for part in ast.walk(node)]
        reports = "isinstance" in words and any(word.endswith("Report") for word in words)
        return isinstance(node, ast.Call) and (reports or "is_scan_mission" in words)

    files = [path for path in (ROOT / "nls" / "cli").glob("*.py") if path.stem not in kinds]
    asked = [f"{name_of(path)}:{node.lineno}" for path in files for node in ast.walk(tree_of(path)) if asks(node)]  # type: ignore[attr-defined]
    assert asked == []


def test_no_file_imports_what_another_keeps_for_itself() -> None:
    """A name with an underscore is of one file, in every package and for the benchmarks."""
    files = [*FILES, *(path for room in ("benchmarks", "tools") for path in (ROOT / room).rglob("*.py"))]
    froms = [(path, node) for path in files for node in ast.walk(tree_of(path)) if isinstance(node, ast.ImportFrom)]
    private = [
        f"{name_of(path)}: {name}" for path, node in froms for name in imported(node) if re.search(r"\._[a-z]", name)
    ]
    assert len(froms) > 1500
    assert private == []


def listed(text: str) -> list[tuple[str, list[str]]]:
    """Modules and names in the tables of a page of the reference, in order."""
    tables = re.findall(r"^```\{names\}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^(\S+):(.*(?:\n .*)*)$", "".join(tables), re.MULTILINE)
    return [(module, names.split()) for module, names in lines]


def test_the_reference_lists_each_public_name_once() -> None:
    """`help(nls)` lists the first fifteen names of the page, in the same order."""
    packages = (models, factors, nls, sim)
    texts = {package: (ROOT / "docs" / "reference" / f"{package.__name__}.md").read_text() for package in packages}
    lines = [line for text in texts.values() for line in listed(text)]
    named = [(f"{module}.{name}", module, name) for module, names in lines for name in names if name.isidentifier()]
    objects = {full: id(getattr(importlib.import_module(module), name)) for full, module, name in named}
    assert len(named) == len(objects) == len(set(objects.values())) > 300
    for package in packages:
        public = [name for name in package.__all__ if not inspect.ismodule(getattr(package, name))]
        assert [name for name in public if f"{package.__name__}.{name}" not in objects] == []
    words = [word for module, names in listed(texts[nls]) for word in names or [module]]
    assert words[:15] == re.findall(r"^    ([\w.]+)  +\w", nls.__doc__ or "", re.MULTILINE)


def test_pages_import_what_a_room_exports_or_the_reference_documents() -> None:
    """Readers copy these lines. A room is a folder of a package, its `__init__` has the public names."""
    pages = [ROOT / "README.md", *(path for ending in ("md", "ipynb") for path in (ROOT / "docs").rglob(f"*.{ending}"))]
    texts = {path: path.read_text(encoding="utf-8") for path in pages if "_build" not in path.parts}
    documented = {module for text in texts.values() for module, _ in listed(text)}
    line = re.compile(rf"""^(?:>>> |    ")?from ((?:{"|".join(PACKAGES)})[\w.]*) import ([\w, ]+)""", re.MULTILINE)
    imports = {(path, *found) for path, text in texts.items() for found in line.findall(text)}
    assert len(imports) > 100
    inner = []
    for path, module, names in imports:
        exported = (
            getattr(importlib.import_module(module), "__all__", ())
            if (ROOT / module.replace(".", "/")).is_dir()
            else ()
        )
        if module not in documented and not {name.split()[0] for name in names.split(",")} <= {*exported}:
            inner.append(f"{name_of(path)}: from {module} import {names}")
    assert inner == []


def test_files_are_short_and_say_what_they_are() -> None:
    files = [*FILES, *(ROOT / "tests").rglob("*.py")]
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert len(FILES) > 200
    assert {name_of(path): n for path, n in lines.items() if n > 400} == {}
    assert [name_of(path) for path in FILES if not ast.get_docstring(tree_of(path))] == []


def test_constants_of_one_name_are_few() -> None:
    """A constant says what it bounds: one name in more than three files of `nls` bounds nothing in particular."""
    files: dict[str, set[str]] = {}
    for path in (path for path in FILES if name_of(path).startswith("nls/")):
        nodes = [node for node in tree_of(path).body if isinstance(node, ast.Assign)]
        for name in (part for node in nodes for target in node.targets for part in ast.walk(target)):
            if isinstance(name, ast.Name) and name.id.isupper() and name.id != "TYPE_CHECKING":
                files.setdefault(name.id, set()).add(name_of(path))
    assert len(files) > 300
    assert {name: where for name, where in files.items() if len(where) > 3} == {}


def test_no_module_is_imported_under_a_preposition() -> None:
    imports = [
        node for path in FILES for node in ast.walk(tree_of(path)) if isinstance(node, ast.Import | ast.ImportFrom)
    ]
    renamed = [alias.asname for node in imports for alias in node.names if alias.asname]
    assert len(renamed) > 50
    assert {*renamed} & {"as", "at", "by", "for", "from", "in", "of", "on", "over", "to", "under", "with"} == set()


def given_names(tree: ast.Module) -> Iterator[str]:
    """Names of the variables, arguments, attributes and functions that a file makes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


def test_names_are_nouns_and_verbs() -> None:
    pronouns = {
        name_of(path): NO_NAMES & {name.strip("_").lower() for name in given_names(tree_of(path))} for path in FILES
    }
    assert {name: names for name, names in pronouns.items() if names} == {}


def test_docstrings_begin_with_the_thing() -> None:
    """A reader of one function has not read what a pronoun stands for."""
    first = "It|Its|They|Their|This|That|These|Those|Same|The same|With|The others?"
    pronoun = re.compile(rf"(?:{first}|(?:Whether|Where|What|How|As|If|When|Of|In) (?:it|they|this|these|those))\b")
    files = [*FILES, *(path for room in ("benchmarks", "tools") for path in (ROOT / room).rglob("*.py"))]
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef
    nodes = [(path, node) for path in files for node in ast.walk(tree_of(path)) if isinstance(node, kinds)]
    begins = [
        f"{name_of(path)}: {doc[:60]}"
        for path, node in nodes
        if (doc := ast.get_docstring(node) or "") and pronoun.match(doc)
    ]
    assert len(nodes) > 3000
    assert begins == []


def undocumented(module: ModuleType) -> Iterator[str]:
    """Public names of a module that do not exist, are listed twice or have no docstring."""
    public = getattr(module, "__all__", [])
    yield from {f"{module.__name__}.{name} twice" for name in public if public.count(name) > 1}
    for name in public:
        value = getattr(module, name, None)
        documented = not (inspect.isclass(value) or inspect.isfunction(value)) or inspect.getdoc(value)
        if not hasattr(module, name) or not documented:
            yield f"{module.__name__}.{name}"
        if inspect.isclass(value) and module.__name__ in PACKAGES:
            methods = [m for m, method in vars(value).items() if inspect.isfunction(method) and m[0] != "_"]
            for member in methods:
                if not inspect.getdoc(getattr(value, member)):
                    yield f"{module.__name__}.{name}.{member}"


def test_tab_completion_shows_the_public_names() -> None:
    """None that the file of a package needs for itself, and of its modules the rooms of `nls` that pages use."""
    assert {"analysis", "filters", "metrics", "plot", "sonar", "starts"} <= {*dir(nls)}
    for package in (models, factors, nls, sim):
        assert {name for name in dir(package) if not name.startswith("__")} == set(package.__all__)
    for package in (nls, sim):
        assert {
            name for name in ("importer", "TYPE_CHECKING", "Any", "import_module") if hasattr(package, name)
        } == set()


def test_no_two_public_classes_share_a_name() -> None:
    """A class that a room exports is found by its name alone."""
    named: dict[str, set[str]] = {}
    for package in (models, factors, nls, sim):
        rooms = [m.name for m in pkgutil.walk_packages(package.__path__, package.__name__ + ".") if m.ispkg]
        for module in map(importlib.import_module, (package.__name__, *rooms)):
            for value in (getattr(module, name) for name in getattr(module, "__all__", ())):
                if inspect.isclass(value):
                    named.setdefault(value.__name__, set()).add(value.__module__)
    assert len(named) > 100
    assert {name: modules for name, modules in named.items() if len(modules) > 1} == {}


def test_public_names_exist_and_are_documented() -> None:
    packages = (models, factors, nls, sim)
    assert all(package.__all__ and package.__doc__ for package in packages)
    names = [m.name for package in packages for m in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
    modules = [importlib.import_module(name) for name in names if not name.endswith("__main__")]
    assert [name for module in [*packages, *modules] for name in undocumented(module)] == []
