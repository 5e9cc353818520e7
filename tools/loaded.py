"""Which modules of `nls` a command loads, and which of them it loads for nothing: none of their functions is called.

    python tools/loaded.py solve graph.g2o            two numbers, then the modules loaded for nothing
    python tools/loaded.py import log.csv

A module from which a class or a constant alone is taken counts as loaded for nothing, too: `sys.setprofile` sees calls.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).parents[1]


def main(argv: list[str]) -> int:
    sys.path.insert(0, str(ROOT))
    called: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_name != "<module>":
            called.add(frame.f_code.co_filename)

    threading.setprofile(note)
    sys.setprofile(note)
    from nls.cli import main as command

    status = command(argv)
    sys.setprofile(None)
    files = {name: str(module.__file__) for name, module in [*sys.modules.items()] if name.split(".")[0] == "nls"}
    idle = sorted(name for name, file in files.items() if file not in called)
    print(f"{len(files)} modules of nls loaded, {len(idle)} of them for nothing", file=sys.stderr)
    print(*idle, sep="\n", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
