"""Code by room: lines without blanks, comments and docstrings, files, and the rooms of `nls` that each imports.

    python tools/rooms.py           a table: the storeys of `nls` from the roof down, then the other folders

`STOREYS` says which room stands where. Rooms import those of their own storey and of the ones below; a test holds it.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
STOREYS = {
    "commands": ("cli",),
    "missions": ("missions", "sonar"),
    "estimates": (
        *("plot", "io", "explanation", "incremental", "certificate", "filters", "robust"),
        *("analysis", "starts", "metrics"),
    ),
    "engine": (
        *("covariance", "posegraph", "graph", "optimizers", "linear", "gauge", "system", "sparse", "values"),
        *("stages", "lazy"),
    ),
}
OTHERS = ("models", "factors", "sim", "tests", "benchmarks", "tools", "docs")
SKIPPED = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


@dataclass
class Room:
    """What a folder or a module holds."""

    files: int = 0
    lines: int = 0
    imports: frozenset[str] = frozenset()


def code_lines(text: str) -> int:
    """Lines of code of a file: those with a token that is no comment, and no part of a docstring."""
    documented = set[int]()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            documented |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    tokens = [t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type not in SKIPPED]
    return len({line for t in tokens for line in range(t.start[0], t.end[0] + 1)} - documented)


def imported_rooms(text: str) -> frozenset[str]:
    """Rooms of `nls` that a file imports, late and for type checkers, too."""
    names = set[str]()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(name.split(".")[1] for name in names if name.startswith("nls."))


def rooms() -> dict[str, Room]:
    """The rooms of `nls` by name, each folder of `missions` also by ``missions/folder``, and the other folders."""
    out: dict[str, Room] = {}
    for top in ("nls", *OTHERS):
        for path in sorted((ROOT / top).rglob("*.py")):
            inner, text = path.relative_to(ROOT / top).parts, path.read_text(encoding="utf-8")
            names = [inner[0].removesuffix(".py")] if top == "nls" else [top]
            names += ["/".join(inner[:2])] if inner[0] == "missions" and len(inner) > 2 else []
            for name in names:
                room = out.setdefault(name, Room())
                room.files, room.lines = room.files + 1, room.lines + code_lines(text)
                room.imports |= imported_rooms(text) - {name}
    return out


def main() -> int:
    every = rooms()
    print(f"{'room':24s} {'lines':>6s} {'files':>6s}")
    for storey, names in STOREYS.items():
        print(f"nls, {storey}: {sum(every[name].lines for name in names)}")
        for name in names:
            parts = sorted(part for part in every if part.startswith(f"{name}/"))
            for room in [name, *parts]:
                print(f"  {room:22s} {every[room].lines:6d} {every[room].files:6d}")
    for name in OTHERS:
        print(f"{name:24s} {every[name].lines:6d} {every[name].files:6d}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
