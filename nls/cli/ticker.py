"""A line on a terminal that says what a process does and for how long, once a second, until the process ends.

A process of its own writes it. A thread could not: a factorization by CHOLMOD keeps all other threads of Python
waiting. The words are of what was done, the seconds of the stage so far. This file, run by itself, is that process; it
imports nothing of the library.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from time import monotonic

TYPE_CHECKING = False
if TYPE_CHECKING:
    from subprocess import Popen

QUIET, EVERY = 1.0, 0.5  # seconds before the first line, and from line to line


def shows() -> bool:
    """Whether standard error is a terminal whose line can be written again."""
    return sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


class Ticker:
    """The other end of the line: what to say there."""

    def __init__(self) -> None:
        from subprocess import PIPE, Popen

        self._process: Popen[bytes] = Popen([sys.executable, "-I", "-S", __file__], stdin=PIPE, stdout=PIPE, bufsize=0)

    def stage(self, name: str) -> None:
        """A stage begins."""
        self._send(f"*{name}")

    def step(self, words: str) -> None:
        """The latest step of the stage."""
        self._send(f"-{words}")

    def hide(self) -> None:
        """Wait until the line is gone; half a second later it is there again."""
        self._send("")
        assert self._process.stdout is not None
        self._process.stdout.read(1)

    def close(self) -> None:
        """Wait until the line is gone for good."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def _send(self, line: str) -> None:
        from models.visible import visible

        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # somebody ended it: no line, and the work goes on
            self._process.stdin.write(f"{' '.join(visible(line).split())}\n".encode())


class _Line:
    """The line, on standard error."""

    def __init__(self) -> None:
        from threading import Lock

        self._lock = Lock()
        self._stage, self._step, self._shown = "", "", ""
        self._began = self._since = monotonic()

    def draw(self) -> None:
        """Show what is done."""
        with self._lock:
            if (now := monotonic()) - self._began >= QUIET:
                words = ": ".join(filter(None, (self._stage, self._step)))
                text = f"{now - self._since:5.0f} s  {words}"[: (os.get_terminal_size(2).columns or 80) - 1]
                self._write(text.ljust(len(self._shown)), text)

    def erase(self) -> None:
        """Leave an empty line."""
        with self._lock:
            self._write(" " * len(self._shown) + "\r", "")

    def take(self, line: str) -> None:
        """What the other end says."""
        if line.startswith("*"):
            self._stage, self._step, self._since = line[1:], "", monotonic()
        elif line:
            self._step = line[1:]
        else:
            self.erase()
            os.write(1, b"\n")

    def _write(self, text: str, shown: str) -> None:
        sys.stderr.write(f"\r{text}" if shown or self._shown else "")
        sys.stderr.flush()
        self._shown = shown


def _tick() -> None:
    """Draw until the other end closes."""
    import signal
    from threading import Event, Thread

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    line, over = _Line(), Event()

    def drawn() -> None:
        while not over.wait(EVERY):
            line.draw()

    Thread(target=drawn, daemon=True).start()
    with open(0, encoding="utf-8") as lines:
        for words in lines:
            line.take(words.rstrip("\n"))
    over.set()
    line.erase()
    os._exit(0)


if __name__ == "__main__":
    _tick()
