"""Terminals alone show how far a command is, and the color of its verdict."""

from __future__ import annotations

import os
import subprocess
import sys
from time import monotonic

import pytest

from tests.nls.cli.shell import ROOT

pty = pytest.importorskip("pty", reason="no pseudo-terminals here")
BUSY = """
import ctypes, sys, time
from nls.cli.phase import Phase
phase = Phase("nls")
phase.show()
phase.doing = "while reading a\\x1b.g2o"
phase.step("numbers")
ctypes.PyDLL(None).usleep(1_800_000)  # no other thread of Python runs meanwhile, as in a factorization
phase.step("")
print("input", flush=True)
phase.hide()
print("result")
"""


def terminal(*words: str, **env: str) -> list[tuple[float, str]]:
    """What Python writes to a terminal, with the seconds from one piece to the next."""
    here, there = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "NO_COLOR": "", **env}
    with subprocess.Popen(
        [sys.executable, *words], env=environment, stdin=there, stdout=there, stderr=there
    ) as process:
        os.close(there)
        pieces, last = [], monotonic()
        try:
            while piece := os.read(here, 4096):
                pieces.append((monotonic() - last, piece.decode()))
                last = monotonic()
        except OSError:  # how the end of a pseudo-terminal is told
            pass
        os.close(here)
    assert process.returncode == 0, pieces
    return pieces


def test_a_stage_is_shown_while_the_process_is_busy() -> None:
    pieces = terminal("-c", BUSY)
    text = "".join(text for _, text in pieces)
    assert text.count("1 s  reading a\\x1b.g2o: numbers") >= 1
    assert max(seconds for seconds, _ in pieces[1:]) < 1.5
    assert text.endswith("\rinput\r\nresult\r\n")
    assert "\x1b" not in text
