"""Change one token of the sources at a time, and see whether the tests beside that file fail.

    python tools/mutants.py                      150 mutants, seed 0: about two hours of one core
    python tools/mutants.py --count 20 linear    those of files whose path has this word
    python tools/mutants.py --survivors          only those that survived last time, before the whole suite

A mutant swaps one operator (< and <=, + and -, * and /, and/or, is/is not ...) or changes one number, in a copy of the
project. The tests of its room run until one fails: that kills it. What survives is tried again with the whole suite
where --survivors is given. Each result is a line of mutants.csv beside this file; a mutant that is there is not tried
again.
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
from itertools import islice, zip_longest
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).with_name("mutants.csv")
INNER = ("sparse", "linear", "optimizers", "starts", "covariance", "robust", "io", "filters")
ROOMS = ("models", "factors", *(f"nls/{room}" for room in INNER))
SWAPS = {
    **{"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="},
    **{"+": "-", "-": "+", "*": "/", "/": "*", "&": "|", "|": "&", "+=": "-=", "-=": "+=", "*=": "/="},
    **{"and": "or", "or": "and", "not": "", "True": "False", "False": "True", "min": "max", "max": "min"},
    **{"any": "all", "all": "any", "break": "continue", "continue": "break"},
}
SECONDS = 900  # of the tests of a mutant; one that runs longer is killed by the clock


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


def changes(path: Path) -> Iterator[tuple[int, int, str, str]]:
    """Line, column, old and new token of every change that this script knows."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
        new = SWAPS.get(token.string)
        if token.type == tokenize.NUMBER:
            new = {"0": "1", "1": "2", "2": "3", "3": "4"}.get(token.string)  # places and counts; no tuning constant
        if new is not None and not token.line.startswith("@dataclass"):
            yield *token.start, token.string, new


def mutant_of(path: Path, line: int, column: int, old: str, new: str) -> Mutant | None:
    """The mutant, if it is another program; annotations and docstrings change nothing."""
    text = path.read_text(encoding="utf-8")
    source = text.splitlines()[line - 1].strip()
    mutant = Mutant(path.relative_to(ROOT).as_posix(), line, column, old, new, source)
    try:
        return mutant if _program(mutant.applied(text)) != _program(text) else None
    except SyntaxError:
        return None


def _program(text: str) -> str:
    """What a text does, without its annotations."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            if getattr(node, name, None) is not None:
                setattr(node, name, ast.Constant(None))
    return ast.dump(tree)


def chosen(count: int, seed: int, words: list[str]) -> list[Mutant]:
    """As many from every room as there are, as few as possible from one file, of files whose path has all words."""
    rng, drawn = random.Random(seed), []
    for room in ROOMS:
        paths = [path for path in sorted((ROOT / room).rglob("*.py")) if path.name != "__init__.py"]
        files = [path for path in paths if all(word in path.as_posix() for word in words)]
        rng.shuffle(files)
        pools = [(path, rng.sample(tokens, len(tokens))) for path in files if (tokens := list(changes(path)))]
        longest = max((len(pool) for _, pool in pools), default=0)
        turns = [(path, pool[k]) for k in range(longest) for path, pool in pools if k < len(pool)]
        drawn.append((mutant for path, change in turns if (mutant := mutant_of(path, *change))))
    turn = (mutant for mutants in zip_longest(*(islice(room, count) for room in drawn)) for mutant in mutants if mutant)
    return list(islice(turn, count))


def tests_of(file: str) -> list[str]:
    """The tests of the room, those with the name of the file first; and the examples in the file."""
    room = next(room for room in ROOMS if file.startswith(room + "/"))
    folder = ROOT / "tests" / room
    named = sorted(path.relative_to(ROOT).as_posix() for path in folder.rglob(f"test_*{Path(file).stem}*.py"))
    return [file, *named, folder.relative_to(ROOT).as_posix()]


def killed(mutant: Mutant | None, tests: list[str]) -> str:
    """The first test that fails, ``timeout``, or nothing; None for the project as it is."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "project"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "_build", "build", "__pycache__"))
        if mutant is not None:
            path = copy / mutant.file
            path.write_text(mutant.applied(path.read_text(encoding="utf-8")), encoding="utf-8")
        quiet = ("-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider")
        command = [sys.executable, "-m", "pytest", *quiet, *tests]
        environment = os.environ | {"PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
        try:
            run = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=SECONDS)
        except subprocess.TimeoutExpired:
            return "timeout"
    failures = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if run.returncode in (1, 2) and failures:
        return failures[0].split(" - ")[0].split(" ", 1)[1]
    if run.returncode != 0:
        said = f"{run.stdout[-500:]}{run.stderr[-500:]}"
        raise RuntimeError(f"pytest ended with {run.returncode} and named no test: {said}")
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", help="of the path of the file")
    parser.add_argument("--count", type=int, default=150, help="of mutants (default 150)")
    parser.add_argument("--seed", type=int, default=0, help="of the choice (default 0)")
    parser.add_argument("--survivors", action="store_true", help="try what survived again, with the whole suite")
    options = parser.parse_args()
    names = list(Mutant.__dataclass_fields__)
    rows = list(csv.DictReader(RESULTS.open(encoding="utf-8"))) if RESULTS.exists() else []
    results = {tuple(row[name] for name in names): row for row in rows}
    if options.survivors:
        mutants = [Mutant(r["file"], int(r["line"]), int(r["column"]), r["old"], r["new"], r["source"]) for r in rows]
        mutants = [mutant for mutant, row in zip(mutants, rows, strict=True) if not row["killed"]]
    else:
        mutants = chosen(options.count, options.seed, options.words)
        mutants = [mutant for mutant in mutants if tuple(map(str, asdict(mutant).values())) not in results]
    suites = {mutant.file: ["tests"] if options.survivors else tests_of(mutant.file) for mutant in mutants}
    unchanged: dict[str, str] = {}  # what fails without a mutant, by the folder of tests
    for mutant in mutants:
        tests, began = suites[mutant.file], time.monotonic()
        if tests[-1] not in unchanged and (failure := unchanged.setdefault(tests[-1], killed(None, tests[-1:]))):
            print(f"{failure} fails without any mutant: mend it first")
            return 1
        row = asdict(mutant) | {"killed": killed(mutant, tests), "seconds": f"{time.monotonic() - began:.0f}"}
        results[tuple(map(str, asdict(mutant).values()))] = row
        change = f"{mutant.file}:{mutant.line} {mutant.old} -> {mutant.new}: {mutant.source}"
        print(f"{row['killed'] or 'SURVIVED'}: {change}", flush=True)
        with RESULTS.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, [*names, "killed", "seconds"], lineterminator="\n")
            writer.writeheader()
            writer.writerows(results.values())
    survived = sum(not row["killed"] for row in results.values())
    print(f"{len(results) - survived} of {len(results)} killed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
