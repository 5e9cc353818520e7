"""Written g2o files: what cannot be written right is refused, links and permissions stay, bytes come back."""

from __future__ import annotations

import gzip
import os
import threading
from pathlib import Path

import pytest

from factors import Between, Huber, Isotropic, Prior, Robust
from models import SE2
from nls import FactorGraph, GraphFileError, GraphWarning, kinds, load, save
from nls.io.files import write_bytes
from tests.combinations import for_all
from tests.nls.graphs import pose_graph
from tests.nls.io.g2o_files import PLANE, again, assert_unwritable, read, same, write

x, l = kinds("x", "l")


def test_what_the_format_cannot_hold(tmp_path: Path) -> None:
    sample = pose_graph(SE2)
    z = [0.0, 0.0, 0.0]
    partial, offset = Prior(x[0], z, Isotropic(1), ("x", "y")), Prior(x[0], z, Isotropic(1), offset=[1.0, 0.0, 0.0])
    robust = Prior(x[0], z, Robust(Isotropic(1), Huber(1.0)))
    for factor, said in ((partial, "cannot be written"), (offset, "cannot be written"), (robust, "robust kernel")):
        words = rf"out\.g2o: Prior\(x0\) .*{said}"
        assert_unwritable(tmp_path / "out.g2o", words, FactorGraph([factor]), sample.values)


def test_variables_without_a_value_and_two_conventions(tmp_path: Path) -> None:
    graph, values, _ = read(PLANE)
    z, missing = [1.0, 0.0, 0.0], "no variable of kind 'l' has a value"
    mixed = FactorGraph([Between(x[0], x[1], z, Isotropic(1), convention) for convention in ("log", "g2o", "g2o")])
    refused = [
        *((FactorGraph([Between(i, l[1], z, Isotropic(1))]), missing) for i in (l[0], x[0])),
        (FactorGraph([Between(x[0], x[7], z, Isotropic(1))]), "x7 has no value"),
        (FactorGraph(graph.factors, [l[0]]), missing),
        (FactorGraph(graph.factors, [x[7]]), "x7 has no value"),
        (mixed, "g2o, log"),
    ]
    for other, message in refused:
        assert_unwritable(tmp_path / "out.g2o", message, other, values)
    mixed.remove(mixed.factors[0])
    save(tmp_path / "out.g2o", mixed, values)


def test_unused_lines_come_back_byte_for_byte(tmp_path: Path) -> None:
    lines = [b"  WHAT \xff\xfe 1\t2  ", b"WHAT caf\xc3\xa9 \xc2\x85x\r", b"\xe9T\xe9 3"]
    with pytest.warns(GraphWarning) as caught:
        loaded = load(write(tmp_path, PLANE.encode() + b"\n".join(lines) + b"\n"))
    assert all(str(c.message).encode() for c in caught)  # no lone surrogates in messages
    assert str(loaded[2]).encode()
    assert r"\xe9T\xe9" in str(caught[0].message)
    same(loaded, again(loaded, tmp_path))
    assert (tmp_path / "again.g2o").read_bytes().split(b"\n")[-4:-1] == lines


@for_all(name=["out.g2o.gz", "out.G2O.GZ"])
def test_compressed_by_suffix(name: str, tmp_path: Path) -> None:
    graph, values, _ = read(PLANE)
    save(tmp_path / name, graph, values)
    save(tmp_path / "out.g2o", graph, values)
    data = (tmp_path / name).read_bytes()
    assert data[4:8] == bytes(4)  # no time of writing: equal graphs give equal bytes
    assert gzip.decompress(data) == (tmp_path / "out.g2o").read_bytes()
    same(read(PLANE), load(tmp_path / name))


def test_a_pipe_and_a_device_are_written_to(tmp_path: Path) -> None:
    pipe, found = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: found.append(pipe.read_bytes()), daemon=True)
    reader.start()
    write_bytes(pipe, b"new")
    reader.join(10)
    assert found == [b"new"]
    assert pipe.is_fifo()
    write_bytes(os.devnull, b"new")
    assert Path(os.devnull).is_char_device()


def test_what_cannot_be_written_names_the_file_given(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name, reason in (("none/out", "No such file"), ("", "Is a directory"), ("loop", "Too many levels")):
        with pytest.raises(GraphFileError) as caught:
            write_bytes(tmp_path / name, b"new")
        assert str(caught.value).startswith(f"{tmp_path / name}: cannot be written: {reason}")
        assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["loop"]
