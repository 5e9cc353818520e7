"""Promises that hold for every reader: bytes in, a graph that evaluates or one error with file and line out."""

from __future__ import annotations

import gzip
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from models.errors import LeadlineError, SingularGeometryError
from nls import EvaluationError, GraphFileError, GraphWarning, OptionError, ResourceLimitError, load
from nls.io import DIALECTS
from tests.combinations import for_all
from tests.nls.io.g2o_files import again, assert_refused, read, same, write
from tests.nls.io.io_files import ALL, FILES, read_any

NUMBERS = ["0", "-1", "9", "1e308", "-1e308", "1e-308", "3.5", "007", "9223372036854775807", "1e160"]
WORDS = ["", *f"nan inf 1_0 \uff11 0x1 # FIX EDGE2 VERTEX_XY EDGE_SE3:QUAT {2**63} 1e999".split()]
EXOTIC = ["inf", "1_0", "\uff11", "0x1A", "1e999", "1,5", "--1"]
names = st.sampled_from(list(ALL))
damage = settings(max_examples=200, suppress_health_check=[HealthCheck.too_slow])


def read_or_refused(data: bytes, dialect: str) -> bool:
    """P1, P6: a graph of finite numbers whose chi2 is one, or an error with file and line; whether it was read."""
    refused: LeadlineError | None = None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", GraphWarning)
        try:
            graph, values, _ = read_any(data, dialect)
        except (GraphFileError, ResourceLimitError, OptionError) as error:
            refused = error
    if refused is not None:
        if isinstance(refused, GraphFileError):
            assert str(refused).startswith("f.g2o")
            assert refused.line is not None
            assert 1 <= refused.line <= data.count(b"\n") + 1
        return False
    assert all(np.isfinite(stack.X).all() for stack in values.stacks.values())
    assert all(key in values for factor in graph.factors for key in factor.keys)
    chi2 = 0.0
    try:
        chi2 = graph.chi2(values) if graph.factors else 0.0
    except (EvaluationError, SingularGeometryError) as error:  # too far off, or a target at the sensor
        refused = error
    assert np.isfinite(chi2)
    assert refused is None or any(factor.name in str(refused) for factor in graph.factors)
    return True


@given(name=names, data=st.data())
@damage
def test_damaged_lines(name: str, data: st.DataObject) -> None:
    dialect, text = ALL[name]
    lines = text.splitlines()
    acts = st.sampled_from(["drop", "twice", "cut", "number", "word", "insert", "swap"])
    for act, place in data.draw(st.lists(st.tuples(acts, st.integers(0, 10**6)), max_size=5)):
        k = place % len(lines)
        words = lines[k].split()
        j = place // len(lines) % (len(words) or 1)
        if act == "drop":
            lines = lines[:k] + lines[k + 1 :] or [""]
        elif act == "twice":
            lines.insert(place // 7 % len(lines), lines[k])
        elif act == "cut":
            lines[k] = lines[k][: j * 3]
        elif act == "swap":
            lines[k], lines[0] = lines[0], lines[k]
        elif words:
            word = data.draw(st.sampled_from(NUMBERS if act == "number" else WORDS))
            words[j : j + (act != "insert")] = [word]
            lines[k] = " ".join(words)
    read_or_refused("\n".join(lines).encode(), dialect)


@for_all(name=ALL)
def test_the_undamaged_file_is_read_packed_marked_and_truncated(name: str, tmp_path: Path) -> None:
    dialect, text = ALL[name]
    assert read_or_refused(text.encode(), dialect)
    if dialect != "bal":
        for cut in range(0, len(text), 97):
            read_or_refused(text[:cut].encode(), dialect)
    one = load(write(tmp_path, text), dialect=dialect)
    changed = text.replace("\n", "\r\n").replace(" ", "\t")
    for data in (gzip.compress(text.encode()), b"\xef\xbb\xbf" + text.encode(), changed.encode()):
        other = load(write(tmp_path, data), dialect=dialect)
        assert all(np.array_equal(one[1].stacks[k].X, s.X) for k, s in other[1].stacks.items())
        assert other[0].chi2(other[1]) == one[0].chi2(one[1])


@for_all(name=ALL)
def test_no_exotic_number_gets_through(name: str) -> None:
    """In every line nan, and one of the others in turn."""
    dialect, text = ALL[name]
    lines = text.splitlines()
    for k, line in enumerate(lines):
        if not line.startswith("FIX"):
            for word in ("nan", EXOTIC[k % len(EXOTIC)]):
                damaged = [*lines[:k], " ".join([*line.split()[:-1], word]), *lines[k + 1 :]]
                assert_refused(k + 1, "", read_any, "\n".join(damaged).encode(), dialect)


@for_all(name=FILES)
def test_extreme_ids_blank_lines_and_comments(name: str, tmp_path: Path) -> None:
    dialect, text = FILES[name]
    big, low = str(2**63 - 1), str(-(2**63))

    def renamed(line: str) -> str:
        words = line.split()
        ids = 0 if words[0].startswith("PARAMS") else 1 if words[0].startswith("VERTEX") else 2
        ids = 1 if "PRIOR" in words[0] else len(words) - 1 if words[0] == "FIX" else ids
        names = {"1": big, "0": low}
        return " ".join([words[0], *(names.get(w, w) for w in words[1 : 1 + ids]), *words[1 + ids :]])

    loaded = read("# one\n\n" + "\n  # two\n\n".join(map(renamed, text.splitlines())), dialect=dialect)
    assert {2**63 - 1, -(2**63)} <= set(loaded[1].stacks["x"].numbers.tolist())
    assert any(note.endswith("comment lines") for note in loaded[2].notes)
    if name != "toro, space":
        same(loaded, again(loaded, tmp_path, dialect=dialect))


@for_all(name=FILES)
def test_lines_in_any_order(name: str) -> None:
    """Edges before vertices, FIX before what it names, parameters last: the same chi2."""
    dialect, text = FILES[name]
    one = read(text, dialect=dialect)
    order = np.random.default_rng(len(name)).permutation(len(text.splitlines()))
    two = read("\n".join(np.array(text.splitlines())[order].tolist()), dialect=dialect)
    if one[2].vertices_given:
        assert two[0].chi2(two[1]) == pytest.approx(one[0].chi2(one[1]), rel=1e-12)
    assert len(two[0]) == len(one[0])
    numbers = [{k: sorted(s.numbers.tolist()) for k, s in values.stacks.items()} for _, values, _ in (one, two)]
    assert numbers[0] == numbers[1]
    fixed = [sorted(repr(k) for keys in graph.fixed for k in keys) for graph, _, _ in (one, two)]
    assert fixed[0] == fixed[1]


def test_empty_files(tmp_path: Path) -> None:
    for dialect in DIALECTS:
        for data in (b"", b"\n \n", gzip.compress(b"")):
            with pytest.raises(GraphFileError, match=r"graph\.g2o(:\d)?: .*"):
                load(write(tmp_path, data), dialect=dialect)
