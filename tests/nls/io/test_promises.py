"""Promises of every reader: a graph that evaluates or one error with its line; no more memory than stated (P9)."""

from __future__ import annotations

import gzip
import io
import re
import tracemalloc
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from models.errors import LeadlineError, SingularGeometryError
from nls import EvaluationError, GraphFileError, GraphWarning, OptionError, ResourceLimitError, load
from nls.io import DIALECTS, bounded_text, files
from nls.io.bounded_text import PER_BYTE, PER_WORD
from nls.io.files import read_bytes, read_stream
from nls.io.text import Text
from nls.io.trajectory import read_kitti, read_tum
from nls.linear import limits
from nls.missions.folder.table import Table
from tests.combinations import for_all
from tests.nls.io.g2o_files import again, assert_refused, read, same, write
from tests.nls.io.io_files import ALL, FILES, ISAM_2, PLANE, PYFG, SPACE, read_any

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


N = 1 << 15
CHUNK, BASE = 1 << 12, 1 << 17  # bytes read at once here; that any call takes: messages, short arrays
READERS: dict[str, Callable[[Path], Any]] = {
    "graph": load,
    "isam": lambda path: load(path, dialect="isam"),
    "pyfg": lambda path: load(path, dialect="pyfg"),
    "bal": lambda path: load(path, dialect="bal"),
    "tum": read_tum,
    "kitti": read_kitti,
    "table of a mission": lambda path: Table(path, ["time_s", "z_m"]).floats("z_m"),
}
IDLE = {
    "newlines": b"\n" * N,
    "carriage returns": b"\r" * N,
    "pairs": b"\r\n" * (N // 2),
    "spaces": b" " * N,
    "commas": b"," * N,
    "rows of nothing": b",\n" * (N // 2),
    "one comment": b"#" + b"x" * (N - 2) + b"\n",
    "one comment of words": b"#" + b" a" * (N // 2) + b"\n",
    "comments": b"#\n" * (N // 2),
    "comments of words": b"  # a b\n" * (N // 8),
}
FULL = {
    "one word": b"x" * N,
    "one number": b"1" * N,
    "quotation marks": b'"' * N,
    "words on one line": b"1 " * (N // 2),
    "a word a line": b"1\n" * (N // 2),
    "unknown tags": b"T\n" * (N // 2),
    "blanks that are none": b"\xc2\xa0" * (N // 2),
    "a graph": PLANE.encode() * (N // len(PLANE)),
    "in space": SPACE.encode() * (N // len(SPACE)),
    "a graph with names": PYFG.encode() * (N // len(PYFG)),
    "a graph of iSAM": ISAM_2.encode() * (N // len(ISAM_2)),
    "what is held": PLANE.encode() + b"FIX 0\n" * (N // 6),
    "poses": b"".join(b"%d 1 2 3 0 0 0 1\n" % k for k in range(N // 20)),
    "rows": b"time_s,z_m\n" + b"1,2\n" * (N // 4),
}
PARTS = IDLE | FULL


def peak(read: Callable[[Path], Any], path: Path) -> tuple[int, str]:
    """The most memory a reader takes, and its error."""
    message = ""
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.setattr(files, "CHUNK", CHUNK)
        warnings.simplefilter("ignore")
        tracemalloc.start()
        try:
            read(path)
        except LeadlineError as error:
            message = str(error)
        finally:
            used = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
    return used, message


def stated(data: bytes) -> int:
    """The memory that reading may take, counted another way than the reader counts."""
    lines = len(re.findall(rb"\r\n|\r|\n", data)) + 1
    return PER_BYTE * len(data) + PER_WORD * (len(data.split()) + lines + data.count(b",") + data.count(b'"')) + BASE


@pytest.fixture(scope="module", autouse=True)
def _warm(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Modules are loaded before memory is counted."""
    path = tmp_path_factory.mktemp("warm") / "f.g2o"
    for text in (PLANE, SPACE, PYFG, ISAM_2):
        path.write_text(text)
        for reading in READERS.values():
            peak(reading, path)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "f.g2o"


@for_all(reader=READERS)
def test_every_reader_keeps_to_what_is_stated(reader: str, file: Path) -> None:
    reading = READERS[reader]
    behind = {"behind: " + name: PLANE.encode() + data for name, data in IDLE.items()} if reader == "graph" else {}
    for name, data in (PARTS | behind).items():
        file.write_bytes(data)
        used, _ = peak(reading, file)
        assert used < stated(data), (name, used, stated(data))


@for_all(reader=READERS)
def test_a_bomb_is_refused_on_the_way(reader: str, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blanks and comments of 25 times what is allowed, packed or not: no more is read than that."""
    monkeypatch.setattr(bounded_text, "SLACK", 1 << 15)
    for name, part in IDLE.items():
        data = PLANE.encode() * (len(name) % 2) + part * 25
        for content in (data, gzip.compress(data, 1)):
            file.write_bytes(content)
            used, message = peak(READERS[reader], file)
            verb = "has" if content is data else "unpacks to"
            assert re.search(rf"f\.g2o: {verb} [0-9,]+ bytes or more of blanks, commas and comments", message), name
            assert used < PER_BYTE * bounded_text.SLACK + 32 * CHUNK, (name, used)


@given(st.lists(st.sampled_from([b"a", b"#", b" ", b"\t", b"\n", b"\r", b"\r\n", b",", b"7"]), max_size=60), st.data())
def test_comments_are_counted_whatever_the_chunks(words: list[bytes], data: st.DataObject) -> None:
    text = b"".join(words)
    pieces, rest, content, count = bounded_text.BoundedText("f: has"), text, 0, 0
    while rest:
        size = data.draw(st.integers(1, len(rest)))
        content += pieces._content(rest[:size])
        count += bounded_text._words(rest[:size])
        rest = rest[size:]
    lines = [line for line in re.split(rb"[\r\n]", text) if not line.lstrip().startswith(b"#")]
    assert content == sum(1 for line in lines for byte in line if byte > 0x20 and byte != ord(","))
    assert count >= len(text.split())


def test_the_limits_to_the_byte(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounded_text, "SLACK", 1000)
    file.write_bytes(b"EDGE" + b"\n" * (1000 + 4 * 4))
    assert len(read_bytes(file)) == 1020
    file.write_bytes(b"EDGE" + b"\n" * (1001 + 4 * 4))
    with pytest.raises(ResourceLimitError, match=r"f\.g2o: has 1,017 bytes .* beside 4 others, the limit is 1,016"):
        read_bytes(file)
    file.write_bytes(b"EDGE\n" + b"1 " * 500)
    needed = PER_BYTE * 1005 + PER_WORD * (501 + 1 + 1)
    monkeypatch.setattr(bounded_text, "default_limit", lambda: needed)
    assert len(read_bytes(file)) == 1005
    monkeypatch.setattr(bounded_text, "default_limit", lambda: needed - 1)
    for data in (file.read_bytes(), gzip.compress(file.read_bytes())):
        file.write_bytes(data)
        with pytest.raises(
            ResourceLimitError, match=r"f\.g2o: .* 1,005 bytes or more, .* takes 0\.0000583 GB"
        ) as caught:
            read_bytes(file)
        assert (caught.value.needed, caught.value.limit) == (needed, needed - 1)


def test_a_large_file_is_refused_by_its_size(file: Path) -> None:
    with file.open("wb") as hole:
        hole.truncate(1 << 42)  # without a block on the disk
    used, message = peak(load, file)
    assert "has 4,398,046,511,104 bytes or more, to read them takes" in message
    assert used < BASE


def test_words_of_many_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    data = b"".join(b"T%d\n" % k for k in range(2000))
    tracemalloc.start()
    assert len(Text(data).tags) == 2000
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert used < PER_BYTE * len(data) + (700 + PER_WORD) * 2000
    monkeypatch.setattr("nls.io.text.default_limit", lambda: 1e6)
    with pytest.raises(ResourceLimitError, match=r"<text>: 1,984 lines with first words of many kinds, .* 0\.00139 GB"):
        assert Text(data).tags


def test_a_word_without_end(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused while it is unpacked: one of 2 GB is a file of 2 MB."""
    monkeypatch.setattr(bounded_text, "WORD", 4 * CHUNK)
    for data in (b"x" * (1 << 20), gzip.compress(b"x" * (1 << 20)), PLANE.encode() + b"1" * (1 << 20)):
        file.write_bytes(data)
        for reading in READERS.values():
            used, message = peak(reading, file)
            assert f"a word of {5 * CHUNK:,} bytes or more, the limit is {4 * CHUNK:,}" in message
            assert used < 16 * CHUNK + BASE


@for_all(line=[b"\n", b"# a\n", b"EDGE_SE2 0 1\n"])
def test_a_stream_without_end(line: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounded_text, "SLACK", 1 << 14)
    monkeypatch.setattr(bounded_text, "default_limit", lambda: 1e6)

    class Endless(io.BytesIO):
        def read(self, size: int | None = -1, /) -> bytes:
            return line * CHUNK

    with pytest.raises(ResourceLimitError, match=r"pipe: has [0-9,]+ bytes or more"):
        read_stream(Endless(), "pipe")


def test_the_limit_is_that_of_every_solve(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert bounded_text.default_limit is limits.default_limit
    monkeypatch.setattr(bounded_text, "default_limit", lambda: 1e4)
    file.write_bytes(PLANE.encode() * 10)
    for reading in READERS.values():
        with pytest.raises(ResourceLimitError, match=r"the limit is 0\.0000100 GB"):
            reading(file)
    with pytest.raises(GraphFileError, match="has a zero byte"):
        read_bytes(Path("/dev/zero"))
