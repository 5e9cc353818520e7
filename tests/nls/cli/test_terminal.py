"""Terminals alone show how far a command is, and the color of its verdict."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from time import monotonic

import pytest

from tests.nls.cli.shell import ROOT, Shell, process

pty = pytest.importorskip("pty", reason="no pseudo-terminals here")
BUSY = """
import ctypes, sys, time
from nls.cli.phase import Phase
phase = Phase("nls")
phase.ticker.start()
phase.ticker._process.send_signal(2)  # Ctrl-C while the ticker starts
phase.begin("while reading a\\x1b.g2o")
phase.step("numbers")
ctypes.PyDLL(None).usleep(2_500_000)  # no other thread of Python runs meanwhile, as in a factorization
phase.step("")
print("input", flush=True)
phase.ticker.close()
print("result")
"""


def arriving(here: int) -> Iterator[str]:
    """What is written to a pseudo-terminal, until nobody has it open."""
    with suppress(OSError):  # how its end is told
        while piece := os.read(here, 4096):
            yield piece.decode()


def terminal(*words: str, **env: str) -> list[tuple[float, str]]:
    """What Python writes to a terminal, with the seconds from one piece to the next."""
    here, there = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "NO_COLOR": "", **env}
    with subprocess.Popen(
        [sys.executable, *words], env=environment, stdin=there, stdout=there, stderr=there
    ) as process:
        os.close(there)
        pieces, last = [], monotonic()
        for piece in arriving(here):
            pieces.append((monotonic() - last, piece))
            last = monotonic()
        os.close(here)
    assert process.returncode == 0, pieces
    return pieces


def test_a_stage_is_shown_while_the_process_is_busy() -> None:
    pieces = terminal("-c", BUSY)
    text = "".join(text for _, text in pieces)
    assert text.count("1 s  reading a\\x1b.g2o: numbers") >= 1
    assert max(seconds for seconds, _ in pieces[1:]) < 2
    assert text.endswith("\rinput\r\nresult\r\n")
    assert "\x1b" not in text


def test_a_job_in_the_background_leaves_the_terminal_to_the_shell() -> None:
    child, here = pty.fork()
    if not child:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm"}
        job = subprocess.run([sys.executable, "-c", BUSY], env=environment, process_group=0, check=False)
        os._exit(job.returncode)
    assert "".join(arriving(here)) == "input\r\nresult\r\n"
    assert os.waitpid(child, 0)[1] == 0


DEAF = """
import ctypes, signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from nls.cli.phase import Phase
phase = Phase("nls")
phase.ticker.start()
phase.begin("while solving a.g2o")
phase.step("iteration 3")
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # as long as a factorization, which hears nothing
ctypes.PyDLL(None).usleep({})
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
"""


@pytest.mark.parametrize(("presses", "busy", "status"), [(2, 20, -signal.SIGTERM), (1, 3, -signal.SIGINT)])
def test_ctrl_c_within_a_step_is_answered(presses: int, busy: int, status: int) -> None:
    """A second one ends the command at once; after the first one its step goes on, and Python ends it then."""
    child, here = pty.fork()
    if not child:
        os.environ |= {"PYTHONPATH": str(ROOT), "TERM": "xterm"}
        os.execv(sys.executable, [sys.executable, "-c", DEAF.format(busy * 1_000_000)])
    text, sent, began = "", 0, monotonic()
    for piece in arriving(here):
        text += piece
        if sent < presses and ("iteration 3" if not sent else "Ctrl-C again") in text:
            sent += 1
            os.write(here, b"\x03")
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == status, text
    assert ("interrupted within a step: solving a.g2o: iteration 3" in text) == (presses == 2)
    assert monotonic() - began < 8


def test_the_verdict_has_a_color_where_somebody_sees_it(shell: Shell) -> None:
    shell.file()
    for words, verdict in (("solve", "result      converged"), ("explain", "9 unknowns, all determined")):
        command = ["-m", "nls", words, "graph.g2o"]
        colored = "".join(text for _, text in terminal(*command))
        assert re.search(rf"\x1b\[3[23]m{verdict}[^\n]*\x1b\[0m\r\n", colored)
        assert colored.count("\x1b") == 2
        for plain in ({"NO_COLOR": "1"}, {"TERM": "dumb"}):
            assert "\x1b" not in "".join(text for _, text in terminal(*command, **plain))
        assert "\x1b" not in shell(f"{words} graph.g2o")
    assert terminal("-m", "nls", "solve", "graph.g2o")[0][1].startswith("input       graph.g2o: 4 variables")


def test_the_tab_key_completes_commands_options_and_their_values(tmp_path: Path) -> None:
    pytest.importorskip("argcomplete", reason="pip install leadline[completion]")
    answer = tmp_path / "answer"
    for line, completed in (
        ("nls ev", "evaluate "),
        ("nls solve --ce", "--certify "),
        ("nls solve --gauge pr", "prior "),
    ):
        asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
        process("-m", "nls", env=asked | {"_ARGCOMPLETE_STDOUT_FILENAME": str(answer)})
        assert answer.read_text() == completed
