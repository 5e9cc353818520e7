"""Contenders that are C++ programs: compiled here, run without Python, and their two files read.

g++ searches where CPLUS_INCLUDE_PATH and LIBRARY_PATH say, beside the folders of the system; a program searches its
libraries where LD_LIBRARY_PATH says.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from peers import TOLERANCE, Files

__all__ = ["NotCompiledError", "collect", "command", "compiled"]

FLAGS = ("-std=c++17", "-O3", "-DNDEBUG", "-I/usr/include/eigen3", "-Wl,--no-as-needed")


class NotCompiledError(Exception):
    """A program cannot be made here; the message says why."""


def compiled(source: Path, libraries: tuple[str, ...], folder: Path) -> Path:
    """The program of a source file.

    Raises
    ------
    NotCompiledError
        there is no g++, a header or a library is missing, or the source does not fit the library
    """
    program = folder / source.stem
    words = [*FLAGS, str(source), "-o", str(program), *(f"-l{library}" for library in libraries)]
    if shutil.which("g++") is None:
        raise NotCompiledError("g++ is not installed")
    done = subprocess.run(["g++", *words], capture_output=True, text=True)
    if done.returncode:
        reasons = re.findall(r"(?:error: |ld: )(.*)", done.stderr) or [f"g++ ended with {done.returncode}"]
        raise NotCompiledError(f"{source.name} does not compile: {reasons[0]}")
    return program


def command(program: str, variant: str, files: Files, out: Path) -> list[str]:
    """How a program is run; see driver.h."""
    words = [program, str(files.complete), str(out.with_suffix("")), variant, str(int(files.space))]
    return [*words, str(TOLERANCE), str(files.most)]


def collect(out: Path) -> dict[str, Any]:
    """The record of a run, and its poses as those of a contender in Python."""
    poses = np.loadtxt(out.with_suffix(".txt"), ndmin=2)
    np.savez(out, ids=poses[:, 0].astype(np.int64), X=poses[:, 1:])
    return dict(json.loads(out.with_suffix(".json").read_text()))
