"""Builds the source distribution and checks its content.

    python tools/check_sdist.py

It has every module of the packages, the licence, the notices, README and the pictures that README shows, and no tests:
these need files of the repository. It is built from the tracked files, in an environment of its own. Prints what is
wrong, a line each; the exit status is 1 if anything is.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import venv
from collections.abc import Collection
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("models", "factors", "nls", "sim")
TOP = ("LICENSE", "NOTICE.md", "README.md", "pyproject.toml")
PICTURE = re.compile(r'(?:\]\(|src=")(docs/[^)"#\s]+\.(?:png|svg|jpg|webp))')
BUILD = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"


def tracked() -> list[str]:
    """The files of the repository."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True)
    return [name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def built(files: Collection[str]) -> set[str]:
    """The files of the source distribution of these files, without its folder."""
    requires = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    with tempfile.TemporaryDirectory() as folder:
        source, out, environment = (Path(folder, name) for name in ("source", "out", "environment"))
        for name in files:
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)
        out.mkdir()
        venv.create(environment, with_pip=True)
        python = environment / ("Scripts" if sys.platform == "win32" else "bin") / "python"
        quiet = {"check": True, "capture_output": True}
        subprocess.run([python, "-m", "pip", "install", "--quiet", *requires], **quiet)  # type: ignore[call-overload]
        subprocess.run([python, "-c", BUILD, out], cwd=source, **quiet)  # type: ignore[call-overload]
        (archive,) = out.iterdir()
        with tarfile.open(archive) as content:
            return {member.name.partition("/")[2] for member in content if member.isfile()}


def problems(names: Collection[str], files: Collection[str], readme: str) -> list[str]:
    """What is wrong with a source distribution.

    Parameters
    ----------
    names : of its files.
    files : of the repository.
    readme : the text of README.md.
    """
    needed = {*TOP, *PICTURE.findall(readme), *(name for name in files if name.split("/")[0] in PACKAGES)}
    wrong = [f"{name} is missing" for name in sorted(needed - set(names))]
    tests = [name for name in sorted(names) if name.startswith("tests/")]
    return wrong + [f"{name} is there: tests need the repository" for name in tests]


def main() -> int:
    """Build, check, print; returns the exit status."""
    files = tracked()
    wrong = problems(built(files), files, (ROOT / "README.md").read_text(encoding="utf-8"))
    print("\n".join(wrong) if wrong else "the source distribution is whole")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
