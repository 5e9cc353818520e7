"""Change one token of the sources at a time, and see whether the tests beside that file fail.

    python tools/mutants.py                      150 mutants, seed 0: about two hours of one core
    python tools/mutants.py --count 20 linear    those of files whose path has this word
    python tools/mutants.py --survivors          only those that survived last time, before the whole suite

A mutant swaps one operator (< and <=, + and -, * and /, and/or, is/is not ...) or changes one number, in a copy of the
project. The tests of its room run until one fails: that kills it. What survives is tried again with the whole suite
where --survivors is given. Each result is a line of mutants.csv beside this file; a mutant that is there is not tried
again unless its line of source has changed.
"""

from __future__ import annotations

import argparse
import ast
import csv
import io
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
import tokenize
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).with_name("mutants.csv")
ROOMS = (
    "models",
    "factors",
    *(f"nls/{room}" for room in ["sparse", "linear", "optimizers", "starts", "covariance", "robust", "io", "filters"]),
)
SWAPS = {
    **{"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="},
    **{"+": "-", "-": "+", "*": "/", "/": "*", "&": "|", "|": "&", "+=": "-=", "-=": "+=", "*=": "/="},
    **{"and": "or", "or": "and", "not": "", "True": "False", "False": "True", "min": "max", "max": "min"},
    **{"any": "all", "all": "any", "break": "continue", "continue": "break"},
}
SECONDS = 900  # of the tests of a mutant; one that runs longer is killed by the clock
COPIED = (
    "models",
    "factors",
    "nls",
    "sim",
    "tests",
    "benchmarks",
    "tools",
    "docs",
    "pyproject.toml",
    "README.md",
    "Makefile",
)


@dataclass(frozen=True)
class Mutant:
    """One token of a file, and another in its place; `line` counts from 1, `column` from 0."""

    file: str
    line: int
    column: int
    old: str
    new: str
    source: str

    def applied(self, text: str) -> str:
        """The text of its file with the token changed."""
        lines = text.splitlines(keepends=True)
        row = lines[self.line - 1]
        lines[self.line - 1] = row[: self.column] + self.new + row[self.column + len(self.old) :]
        return "".join(lines)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Every change of one token that is another program; annotations and docstrings change nothing, so they are not."""
    text = path.read_text(encoding="utf-8")
    before, lines = _program(text), text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        new = SWAPS.get(token.string)
        if token.type == tokenize.NUMBER:
            new = {"0": "1", "1": "2", "2": "3", "3": "4"}.get(token.string)  # places and counts; no tuning constant
        if new is None or token.line.startswith("@dataclass"):
            continue
        (line, column), old = token.start, token.string
        mutant = Mutant(path.relative_to(ROOT).as_posix(), line, column, old, new, lines[line - 1].strip())
        try:
            after = _program(mutant.applied(text))
        except SyntaxError:
            continue
        if after != before:
            yield mutant


def _program(text: str) -> str:
    """What a text does, without its annotations."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            if getattr(node, name, None) is not None:
                setattr(node, name, ast.Constant(None))
    return ast.dump(tree)


def chosen(count: int, seed: int, words: list[str]) -> list[Mutant]:
    """As many from every room, as few as possible from one file."""
    rng, drawn = random.Random(seed), []
    for room in ROOMS:
        files = [path for path in sorted((ROOT / room).rglob("*.py")) if path.name != "__init__.py"]
        rng.shuffle(files)
        pools = [rng.sample(found, len(found)) for found in map(list, map(mutants_of, files)) if found]
        turns = [pool[k] for k in range(max(map(len, pools))) for pool in pools if k < len(pool)]
        drawn.append(turns[: -(-count // len(ROOMS))])
    mutants = [mutant for turn in zip(*drawn, strict=True) for mutant in turn][:count]
    return [mutant for mutant in mutants if all(word in mutant.file for word in words)]


def tests_of(file: str) -> list[str]:
    """The tests of the room, those with the name of the file first; and the examples in the file."""
    room = next(room for room in ROOMS if file.startswith(room + "/"))
    folder = ROOT / "tests" / room
    named = sorted(path.relative_to(ROOT).as_posix() for path in folder.rglob(f"test_*{Path(file).stem}*.py"))
    return [file, *named, folder.relative_to(ROOT).as_posix()]


def killed(mutant: Mutant, tests: list[str]) -> str:
    """The first test that fails, ``timeout``, or nothing."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name)
        for part in COPIED:
            source = ROOT / part
            if source.is_dir():
                shutil.copytree(source, copy / part, ignore=shutil.ignore_patterns("_build", "__pycache__"))
            else:
                shutil.copy(source, copy / part)
        path = copy / mutant.file
        path.write_text(mutant.applied(path.read_text(encoding="utf-8")), encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "--no-header",
            "--tb=no",
            "-p",
            "no:cacheprovider",
            *tests,
        ]
        environment = os.environ | {"PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
        try:
            run = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=SECONDS)
        except subprocess.TimeoutExpired:
            return "timeout"
    if run.returncode == 0:
        return ""
    failed = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0].split(" - ")[0].split(" ", 1)[1] if failed else f"exit {run.returncode}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", help="of the path of the file")
    parser.add_argument("--count", type=int, default=150, help="of mutants (default 150)")
    parser.add_argument("--seed", type=int, default=0, help="of the choice (default 0)")
    parser.add_argument("--survivors", action="store_true", help="try what survived again, with the whole suite")
    options = parser.parse_args()
    fields = [*Mutant.__dataclass_fields__, "killed", "seconds"]
    rows = list(csv.DictReader(RESULTS.open(encoding="utf-8"))) if RESULTS.exists() else []
    results = {tuple(row[name] for name in Mutant.__dataclass_fields__): row for row in rows}
    for mutant in chosen(options.count, options.seed, options.words):
        key = tuple(map(str, asdict(mutant).values()))
        if key in results and (results[key]["killed"] or not options.survivors):
            continue
        began = time.monotonic()
        by = killed(mutant, ["tests"] if options.survivors else tests_of(mutant.file))
        results[key] = asdict(mutant) | {"killed": by, "seconds": f"{time.monotonic() - began:.0f}"}
        print(
            f"{by or 'SURVIVED'}: {mutant.file}:{mutant.line} {mutant.old} -> {mutant.new}: {mutant.source}", flush=True
        )
        with RESULTS.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, fields, lineterminator="\n")
            writer.writeheader()
            writer.writerows(results.values())
    survived = sum(not row["killed"] for row in results.values())
    print(f"{len(results) - survived} of {len(results)} killed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
