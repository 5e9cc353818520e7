"""Damaged g2o files: whatever bytes come, a graph of finite numbers or one error with file and line."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nls import GraphFileError, GraphWarning, kinds
from nls.io.read import read_graph
from tests.nls.io.g2o_files import PLANE, SPACE

(x,) = kinds("x")

TOKENS = [
    "0",
    "1",
    "-1",
    "9",
    "1e308",
    "-1e308",
    "1e-308",
    "nan",
    "1e999",
    "x",
    "#",
    "FIX",
    "VERTEX_SE2",
    "VERTEX_SE3:QUAT",
    "EDGE_SE2",
    "EDGE_SE3:QUAT",
    "\xff",
]


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
@given(
    data=st.data(),
    edits=st.lists(
        st.tuples(st.sampled_from(["drop", "insert", "swap", "line"]), st.integers(0, 10**6)), min_size=1, max_size=6
    ),
)
@settings(max_examples=80, suppress_health_check=[HealthCheck.too_slow])
def test_damaged_words(text: str, data: st.DataObject, edits: list[tuple[str, int]]) -> None:
    lines = [line.split() for line in (text + "FIX 0 1\n").splitlines()]
    for how, place in edits:
        line = lines[place % len(lines)]
        k = place // len(lines) % (len(line) + 1)
        if how == "line":
            lines.insert(k, list(line)) if place % 2 else lines.remove(line)
            lines = lines or [[]]
        elif how == "insert":
            line.insert(k, data.draw(st.sampled_from(TOKENS)))
        elif line and how == "drop":
            del line[k - 1]
        elif line:
            line[k - 1] = data.draw(st.sampled_from(TOKENS))
    read_or_refused("\n".join(map(" ".join, lines)).encode("latin-1"))


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
@given(
    edits=st.lists(st.tuples(st.integers(0, 10**6), st.binary(max_size=3), st.integers(0, 4)), min_size=1, max_size=5)
)
@settings(max_examples=80, suppress_health_check=[HealthCheck.too_slow])
def test_damaged_bytes(text: str, edits: list[tuple[int, bytes, int]]) -> None:
    data = text.encode()
    for place, put, cut in edits:
        at = place % (len(data) + 1)
        data = data[:at] + put + data[at + cut :]
    read_or_refused(data)


def read_or_refused(data: bytes) -> None:
    """P1, P6: a graph of finite numbers, or one error with file and line."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", GraphWarning)
        try:
            graph, values, _ = read_graph(data, "f.g2o")
        except GraphFileError as caught:
            refused = caught
            graph, values = None, None
    if graph is None:
        assert str(refused).startswith("f.g2o:")
        assert refused.line is not None
        return
    assert np.isfinite(values[x]).all()
    assert all(key in values for factor in graph.factors for key in factor.keys)
