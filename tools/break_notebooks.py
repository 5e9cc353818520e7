"""Break the library on purpose, one line at a time, and see whether the notebook that has to notice does.

    python tools/break_notebooks.py                    every mutant of broken.toml with its notebook, about 5 minutes
    python tools/break_notebooks.py Jacobian --all     the mutants with this word in their name, with every notebook

A mutant is a copy of the packages with one line changed. A notebook notices when a cell fails, most often one of its
assertions, or when it runs for more than three minutes. A mutant that goes unnoticed ends the run with status 1: an
assertion is missing. That the notebooks pass with the packages as they are is the affair of `make docs`.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("models", "factors", "nls", "sim")
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("[0-9]*.ipynb"))
MUTANTS = tomllib.loads(Path(__file__).with_name("broken.toml").read_text(encoding="utf-8"))["mutant"]
SECONDS = 180
RUN = """
import json, linecache, sys, traceback
import matplotlib
matplotlib.use("Agg")
sys.excepthook = traceback.print_exception  # which finds the source of a cell, as the interpreter's own does not
space = {"__name__": "__main__", "display": print}
for k, cell in enumerate(json.load(open(sys.argv[1]))["cells"]):
    if cell["cell_type"] == "code":
        linecache.cache[f"cell {k}"] = (0, None, "".join(cell["source"]).splitlines(True), "")
        exec(compile("".join(cell["source"]), f"cell {k}", "exec"), space)
"""


@contextmanager
def broken(file: str, right: str, wrong: str) -> Iterator[Path]:
    """A folder with the packages, one line of them changed."""
    with tempfile.TemporaryDirectory() as folder:
        for package in PACKAGES:
            shutil.copytree(ROOT / package, Path(folder, package), ignore=shutil.ignore_patterns("__pycache__"))
        path = Path(folder, file)
        text = path.read_text(encoding="utf-8")
        if text.count(right) != 1:
            sys.exit(f"{file} has {right!r} {text.count(right)} times, expected once: bring broken.toml up to date")
        path.write_text(text.replace(right, wrong), encoding="utf-8")
        yield Path(folder)


def failure(notebook: Path, packages: Path) -> str:
    """How the notebook fails with these packages; empty when it runs through."""
    environment = os.environ | {"PYTHONPATH": str(packages), "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-c", RUN, str(notebook)]
    try:
        ended = subprocess.run(command, env=environment, cwd=packages, capture_output=True, text=True, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        return "no end"
    said = [line.strip() for line in ended.stderr.splitlines() if line.strip("^~ ")]
    return " ".join(said[-2:]) if ended.returncode else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", help="words of the names of mutants; all mutants when omitted")
    parser.add_argument("--all", action="store_true", help="every notebook, not only the one that has to notice")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="notebooks that run at a time")
    given = parser.parse_args()
    unnoticed = 0
    for mutant in MUTANTS:
        name, number, *change = mutant.values()
        if given.words and not any(word in name for word in given.words):
            continue
        asked = [path for path in NOTEBOOKS if given.all or path.name[:2] == number]
        with broken(*change) as packages, ThreadPoolExecutor(given.jobs) as pool:
            said = dict(
                zip(asked, pool.map(lambda path, packages=packages: failure(path, packages), asked), strict=True)
            )
        noticed = [path.name[:2] for path, why in said.items() if why]
        unnoticed += number not in noticed
        why = next((why for path, why in said.items() if path.name[:2] == number), "")
        print(f"{name:38s} {' '.join(noticed) or 'nobody'}  {why:.120}", flush=True)
    return min(unnoticed, 1)


if __name__ == "__main__":
    sys.exit(main())
