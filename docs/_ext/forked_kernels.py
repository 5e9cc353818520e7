"""Kernels of pages as forks of one process that has imported the library: 60 pages import it once.

A page asks for the kernel ``python3``. While the site is built, that is a small program: it asks the warm process for
a fork, and waits for its end. Where a system cannot fork, pages start kernels of their own, as anywhere else.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

__all__ = ["setup"]

ASK = """
import json, os, signal, socket, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
ask = socket.socket(socket.AF_UNIX)
ask.connect(sys.argv[1])
ask.sendall(json.dumps([sys.argv[2], os.getcwd(), dict(os.environ)]).encode() + b"\\n")
ask.recv(1)  # closed when the kernel has ended
"""


def start(folder: Path) -> subprocess.Popen[bytes]:
    """The warm process, and the kernel ``python3`` that asks it, in a folder for JUPYTER_PATH."""
    path = folder / "socket"
    kernel = folder / "kernels" / "python3"
    kernel.mkdir(parents=True)
    argv = [sys.executable, "-S", "-E", "-c", ASK, str(path), "{connection_file}"]
    (kernel / "kernel.json").write_text(json.dumps({"argv": argv, "display_name": "Python 3", "language": "python"}))
    warm = subprocess.Popen([sys.executable, __file__, str(path)], stdout=subprocess.PIPE)
    assert warm.stdout is not None
    warm.stdout.readline()  # it listens
    return warm


def serve(path: str) -> None:
    """Fork a kernel for every one that asks, until the process is ended."""
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # as in every kernel
    import matplotlib.pyplot  # noqa: F401
    import scipy.sparse.linalg  # noqa: F401
    from ipykernel.kernelapp import IPKernelApp

    import factors
    import nls
    import sim  # noqa: F401

    for package in (factors, nls):
        for name in package.__all__:
            getattr(package, name)
    server = socket.socket(socket.AF_UNIX)
    server.bind(path)
    server.listen(64)
    print("listening", flush=True)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for a kernel here
    while True:
        client, _ = server.accept()
        if os.fork():  # the child holds the connection until it ends
            client.close()
            continue
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        server.close()
        connection, folder, environment = json.loads(client.makefile().readline())
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        IPKernelApp.launch_instance(argv=["-f", connection])
        os._exit(0)


def setup(app: Any) -> dict[str, bool]:
    if hasattr(os, "fork"):
        folder = tempfile.TemporaryDirectory()
        warm = start(Path(folder.name))
        os.environ["JUPYTER_PATH"] = os.pathsep.join(filter(None, [folder.name, os.environ.get("JUPYTER_PATH")]))

        def end(*_: object) -> None:
            warm.terminate()
            folder.cleanup()

        app.connect("build-finished", end)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    serve(sys.argv[1])
